// Opening and filtering: all stages at once, what a link leads to, all for print, and the list of runs.
(() => {
  const open = (wanted) => document.querySelectorAll("article.run:not([hidden]) details:is(.whole, .stage)").forEach((item) => { item.open = wanted; });
  document.querySelectorAll("[data-all]").forEach((button) => button.addEventListener("click", () => open(button.dataset.all === "open")));
  // Paper has no disclosure triangles: all is opened for print and put back afterwards, but for runs that are closed: hundreds would be a thousand pages.
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("main details:not([open])")].filter((item) => !item.closest("details.whole:not([open])"));
    closed.forEach((item) => { item.open = true; });
  });
  addEventListener("afterprint", () => closed.forEach((item) => { item.open = false; }));
  // What a link leads to is opened.
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
    // Some browsers forbid it for files, and half a letter has no address: the filter works without.
    try { history.replaceState(null, "", filter.value ? `#runs?${encodeURIComponent(filter.value)}` : "#runs"); } catch { /* as it is */ }
  });
  // A link into a run that the filter hides shows it again.
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
