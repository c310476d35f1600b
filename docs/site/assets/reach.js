// The theme lays wide tables into a frame that scrolls sideways: the keyboard must reach it, too.
addEventListener("load", () => {
  for (const frame of document.querySelectorAll(".md-typeset__scrollwrap")) frame.tabIndex = 0;
});
