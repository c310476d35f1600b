// What a reader takes along: the tables as files, each chart as an SVG that looks the same outside the page.

/** A link that saves what `make` returns, as text, when it is followed. */
function download(name, kind, label, make) {
  const link = el("a", { href: "#", download: name, class: "download" }, label);
  link.addEventListener("click", () => {
    const address = URL.createObjectURL(new Blob([make()], { type: kind }));
    link.href = address;
    setTimeout(() => URL.revokeObjectURL(address), 60_000);
  });
  return link;
}

/** The name of a file made of any text. */
const fileName = (text, otherwise) => text.trim().toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(0, 60) || otherwise;

/** A link that saves the canvas that `make` returns, at once or later, as PNG. */
function pictureDownload(make, name, label) {
  return el("a", { href: "#", class: "download", onclick: async (event) => {
    event.preventDefault();
    const canvas = await make();
    canvas.toBlob((content) => {
      const address = URL.createObjectURL(content);
      el("a", { href: address, download: `${fileName(name(), "picture")}.png` }).click();
      setTimeout(() => URL.revokeObjectURL(address), 60_000);
    }, "image/png");
  } }, label);
}

/** A chart in pixels, three for each of its own. */
async function rastered(chart) {
  const picture = new Image();
  picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(standalone(chart))}`;
  await picture.decode();
  const canvas = el("canvas", { width: 3 * picture.width, height: 3 * picture.height });
  canvas.getContext("2d").drawImage(picture, 0, 0, canvas.width, canvas.height);
  return canvas;
}

/** Links to the tables that came with the study; none where there are none. */
function tableDownloads() {
  const kinds = { "table.csv": ["text/csv", "CSV"], "table.tex": ["application/x-tex", "LaTeX"] };
  const links = Object.entries(table.texts ?? {}).map(([name, text]) => download(name, kinds[name]?.[0] ?? "text/plain", kinds[name]?.[1] ?? name, () => text));
  return links.length ? el("p", { class: "downloads" }, "Save the table: ", ...links.flatMap((link, k) => (k ? [", ", link] : [link]))) : null;
}

const DRAWN = ["fill", "stroke", "stroke-width", "stroke-dasharray", "stroke-opacity", "fill-opacity", "opacity", "font-family", "font-size", "font-weight", "text-anchor", "dominant-baseline"];

/** A chart as a file of its own: what the page's style says of its parts stands in it. */
function standalone(chart) {
  const copy = chart.cloneNode(true);
  const parts = [chart, ...chart.querySelectorAll("*")], copies = [copy, ...copy.querySelectorAll("*")];
  parts.forEach((part, k) => {
    const style = getComputedStyle(part);
    // As attributes: the page's policy lets nobody write styles.
    for (const name of DRAWN) copies[k].setAttribute(name, style.getPropertyValue(name));
    copies[k].removeAttribute("class");
    copies[k].removeAttribute("tabindex");
  });
  const { width, height } = chart.viewBox.baseVal ?? {};
  if (width) copy.setAttribute("width", width);
  if (height) copy.setAttribute("height", height);
  copy.setAttribute("xmlns", SVG);
  const paper = getComputedStyle(chart.closest(".card") ?? document.body).backgroundColor;
  copy.prepend(shape("rect", { x: chart.viewBox.baseVal?.x ?? 0, y: chart.viewBox.baseVal?.y ?? 0, width: "100%", height: "100%", fill: paper }));
  return new XMLSerializer().serializeToString(copy);
}

/** A link below every chart that saves it. */
function chartDownloads(cards) {
  cards.forEach((card, k) => {
    const found = () => card.querySelector("svg:not(.swatch)");
    const name = fileName(card.querySelector("h3, figcaption")?.textContent ?? "", `chart-${k + 1}`);
    if (found()) card.append(el("p", { class: "downloads" },
      download(`${name}.svg`, "image/svg+xml", "Save as SVG", () => standalone(found())), ", ",
      pictureDownload(() => rastered(found()), () => name, "as PNG")));
  });
}
