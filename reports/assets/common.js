"use strict";
// Shared functions: elements, names of files, saving. Pages are readable without scripts.
const touchstone = (() => {
  const make = (name, settings = {}, ...inside) => {
    const element = Object.assign(document.createElement(name), settings);
    element.append(...inside);
    return element;
  };
  // Visible text, without buttons and soft line breaks.
  const words = (element, without = "button, .tools, .sign") => {
    if (!element) return "";
    const copy = element.cloneNode(true);
    copy.querySelectorAll(without).forEach((part) => part.remove());
    return plain(copy.textContent);
  };
  const plain = (text) => text.replaceAll("\u00ad", "").replace(/(\d)\u202f(?=\d)/g, "$1").replace(/\s+/g, " ").trim();
  // Run and stage of a table or figure.
  const whose = (element) => {
    const [run, stage] = ["article.run[data-words]", "details.stage"].map((place) => element.closest(place));
    const headings = [run && run.querySelector("h3"), stage && stage.querySelector("h4")];
    return headings.filter(Boolean).map((heading) => words(heading).split(/ of \d+:/)[0]);
  };
  // Longest part of a file's name, in whole words.
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
  // Quote texts that a spreadsheet would execute.
  const field = (value) => {
    const text = typeof value === "string" && /^[=+\-@−\t\r]./.test(value) && !/^-?[\d.]+(e-?\d+)?$/.test(value) ? `'${value}` : String(value);
    return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const saveCsv = (name, rows) => {
    save(name, new Blob(["\ufeff", rows.map((row) => `${row.map(field).join(",")}\r\n`).join("")], { type: "text/csv" }));
  };
  return { make, named, plain, save, saveCsv, slug, whose, words };
})();
// Open stages, link targets and print content; filter the list of runs.
(() => {
  const open = (wanted) => document.querySelectorAll("article.run:not([hidden]) details:is(.whole, .stage)").forEach((item) => { item.open = wanted; });
  document.querySelectorAll("[data-all]").forEach((button) => button.addEventListener("click", () => open(button.dataset.all === "open")));
  // Open details for print, and restore them; closed runs stay closed, as hundreds would be a thousand pages.
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("main details:not([open])")].filter((item) => !item.closest("details.whole:not([open])"));
    closed.forEach((item) => { item.open = true; });
  });
  addEventListener("afterprint", () => closed.forEach((item) => { item.open = false; }));
  const reveal = () => {
    const target = /^#[\w-]+$/.test(location.hash) ? document.getElementById(location.hash.slice(1)) : null;
    if (!target || !target.closest("details:not([open])")) return;
    for (let at = target.closest("details"); at; at = at.parentElement.closest("details")) at.open = true;
    target.scrollIntoView();
  };
  addEventListener("hashchange", reveal);
  reveal();
  const contents = document.getElementById("contents");
  if (contents && matchMedia("(max-width: 60rem)").matches) contents.open = false;

  const tools = document.querySelector("[data-tools]");
  if (!tools) return;
  tools.hidden = false;
  const filter = document.getElementById("filter");
  if (!filter) return;
  const runs = [...document.querySelectorAll("article.run")];
  const apply = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const run of runs) {
      const text = run.dataset.words.toLowerCase();
      run.hidden = !words.every((word) => text.includes(word));
      shown += run.hidden ? 0 : 1;
    }
    document.getElementById("filter-count").textContent = words.length ? `${shown} of ${runs.length} runs` : "";
  };
  filter.addEventListener("input", () => {
    apply();
    // Some browsers forbid this for files, and it fails for half a surrogate pair; the filter works without.
    try { history.replaceState(null, "", filter.value ? `#runs?${encodeURIComponent(filter.value)}` : "#runs"); } catch { /* as it is */ }
  });
  // A link into a hidden run clears the filter.
  const follow = () => {
    const hash = location.hash;
    if (/^#runs(\?|$)/.test(hash)) {
      try { filter.value = decodeURIComponent(hash.slice(6)); } catch { filter.value = ""; }
      apply();
      document.getElementById("runs").scrollIntoView();
      return;
    }
    const target = /^#[\w-]+$/.test(hash) ? document.getElementById(hash.slice(1)) : null;
    if (target && target.hidden) {
      filter.value = "";
      apply();
      target.scrollIntoView();
    }
  };
  addEventListener("hashchange", follow);
  follow();
})();
