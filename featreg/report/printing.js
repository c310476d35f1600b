// Every pair on paper: the viewer shows one at a time, so its pictures are taken one after the other.

/** A button that draws each result of each pair, then prints the page. */
function printButton(viewer) {
  const box = el("div", { class: "printed", "aria-hidden": "true" });
  const button = el("button", { type: "button", class: "quiet" }, "Print every pair");
  const said = el("span", { "aria-live": "polite" });
  button.addEventListener("click", async () => {
    button.disabled = true;
    said.textContent = "";
    try {
      await gather(viewer, box);
      print();
    } catch (error) {
      box.replaceChildren();
      said.textContent = ` The pictures could not be taken: ${error.message}`;
    } finally {
      button.disabled = false;
    }
  });
  return [el("p", { class: "controls" }, button, said), box];
}

async function gather(viewer, box) {
  const before = { ...viewer.at }, { playing, views } = viewer;
  viewer.playing = false;
  const pages = [];
  try {
    for (const entry of study.entries) {
      const taken = [];
      for (const mode of entry.lattice ? ["matches", "overlay"] : ["matches"]) {
        await viewer.go({ pair: entry.pair, method: entry.method, seed: entry.seed, mode });
        viewer.views?.forEach((view) => view.reset());
        viewer.paint();
        taken.push(el("img", { src: viewer.canvas.toDataURL("image/jpeg", 0.85), alt: viewer.label() }));
      }
      const why = entry.failure || entry.reason;
      pages.push(el("figure", {}, el("figcaption", {}, `${study.methods[entry.method]} on ${study.pairs[entry.pair].name} `, badge(entry.status), why ? ` ${why}` : ""), ...taken));
    }
  } finally {
    viewer.playing = playing;
    await viewer.go(before);
    if (views && viewer.views) viewer.views = views;
    viewer.draw();
  }
  box.replaceChildren(...pages);
  await Promise.all([...box.querySelectorAll("img")].map((image) => image.decode()));
}

// What is folded on the screen is open on paper.
let folded = [];
addEventListener("beforeprint", () => {
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const part of folded) part.open = true;
});
addEventListener("afterprint", () => {
  for (const part of folded) part.open = false;
});
