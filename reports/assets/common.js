"use strict";
// What the other scripts share: elements, names of files, and saving them. Everything on a page can be read without any of them.
const touchstone = (() => {
  const make = (name, settings = {}, ...inside) => {
    const element = Object.assign(document.createElement(name), settings);
    element.append(...inside);
    return element;
  };
  // Text as a reader sees it, without what is only there to be pressed or to break lines.
  const words = (element, without = "button, .tools, .sign") => {
    if (!element) return "";
    const copy = element.cloneNode(true);
    copy.querySelectorAll(without).forEach((part) => part.remove());
    return plain(copy.textContent);
  };
  const plain = (text) => text.replaceAll("\u00ad", "").replace(/(\d)\u202f(?=\d)/g, "$1").replace(/\s+/g, " ").trim();
  // Whose table or figure it is: the run and its stage, or the scene.
  const whose = (element) => {
    const [run, stage, scene] = ["article.run[data-words]", "details.stage", ".of-scene"].map((place) => element.closest(place));
    const headings = [run && run.querySelector("h3"), stage && stage.querySelector("h4"), scene && scene.querySelector("h3")];
    return headings.filter(Boolean).map((heading) => words(heading).split(/ of \d+:/)[0]);
  };
  // Whole words, as many as each part of a file's name has room for.
  const LONGEST = 60;
  const slug = (text) => {
    const all = text.toLowerCase().replace(/[^\p{L}\p{N}_]+/gu, "-").replace(/^-|-$/g, "");
    return all.length > LONGEST ? all.slice(0, LONGEST + 1).replace(/-[^-]*$/, "").slice(0, LONGEST) : all;
  };
  const named = (parts, ending) => `${parts.map(slug).filter(Boolean).join("-") || "touchstone"}.${ending}`;
  const save = (name, blob) => {
    const link = make("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  // A text that a spreadsheet would run stands behind a quotation mark.
  const field = (value) => {
    const text = typeof value === "string" && /^[=+\-@−\t\r]./.test(value) && !/^-?[\d.]+(e-?\d+)?$/.test(value) ? `'${value}` : String(value);
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const saveCsv = (name, rows) => {
    save(name, new Blob(["\ufeff", rows.map((row) => `${row.map(field).join(",")}\r\n`).join("")], { type: "text/csv" }));
  };
  return { make, named, plain, save, saveCsv, slug, whose, words };
})();
