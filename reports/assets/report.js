"use strict";
// Everything on the page can be read without this script; it adds reading values off the plots, filtering and opening.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const digits = (value) => {
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2).replace("e", " × 10^").replace("^+", "^").replace("-", "−");
    return Number(value.toPrecision(4)).toString().replace("-", "−");
  };
  const back = ([low, high, start, end, log], pixel) => {
    const part = (pixel - start) / (end - start);
    return log ? low * (high / low) ** part : low + part * (high - low);
  };
  // The points of a path that the page drew as "Mx,yLx,y".
  const points = (path) => path.getAttribute("d").slice(1).split("L").map((pair) => pair.split(",").map(Number));
  const height = (line, x) => {
    if (x < line[0][0] - 0.6 || x > line[line.length - 1][0] + 0.6) return null;
    for (let place = 1; place < line.length; place += 1) {
      const [left, top] = line[place - 1];
      const [right, bottom] = line[place];
      if (x <= right || place === line.length - 1) {
        const part = right > left ? Math.min(Math.max((x - left) / (right - left), 0), 1) : 1;
        return top + part * (bottom - top);
      }
    }
    return line[0][1];
  };

  const reader = (draw) => {
    const svg = draw.querySelector("svg.plot");
    const output = draw.parentElement.querySelector("output");
    const axes = JSON.parse(svg.dataset.axes);
    const [low, high] = [Math.min(axes.x[2], axes.x[3]), Math.max(axes.x[2], axes.x[3])];
    const lines = [...svg.querySelectorAll("path[data-n]")].map((path) => ({ path, name: path.dataset.n, points: null }));
    let at = null;
    let marks = null;
    const clear = () => {
      if (marks) marks.remove();
      marks = null;
      at = null;
      output.textContent = "";
    };
    const show = (x) => {
      if (marks) marks.remove();
      at = Math.min(Math.max(x, low), high);
      marks = document.createElementNS(SVG, "g");
      const cursor = document.createElementNS(SVG, "path");
      cursor.setAttribute("class", "cursor");
      cursor.setAttribute("d", `M${at},${axes.y[3]}V${axes.y[2]}`);
      marks.append(cursor);
      const told = [];
      for (const line of lines) {
        line.points = line.points || points(line.path);
        const y = height(line.points, at);
        if (y === null) continue;
        told.push(`${line.name} ${digits(back(axes.y, y))}${axes.q[2] && axes.q[2] !== "1" ? ` ${axes.q[2]}` : ""}`);
        const bead = document.createElementNS(SVG, "circle");
        bead.setAttribute("class", `bead ${line.path.getAttribute("class").replace("ln ", "")}`);
        bead.setAttribute("cx", at);
        bead.setAttribute("cy", y);
        bead.setAttribute("r", 3);
        marks.append(bead);
      }
      svg.append(marks);
      output.textContent = `${axes.q[0]} ${digits(back(axes.x, at))} ${axes.q[1]}: ${told.join(", ")}`;
    };
    draw.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      if (box.width > 0) show(((event.clientX - box.left) / box.width) * svg.viewBox.baseVal.width);
    });
    draw.addEventListener("pointerleave", clear);
    draw.addEventListener("blur", clear);
    draw.addEventListener("keydown", (event) => {
      const stride = (high - low) / (event.shiftKey ? 10 : 100);
      const start = at === null ? low - stride : at;
      const target = { ArrowRight: start + stride, ArrowLeft: at === null ? high : start - stride, Home: low, End: high }[event.key];
      if (event.key === "Escape") clear();
      if (target === undefined) return;
      event.preventDefault();
      show(target);
    });
  };
  // A plot gets its listeners when it is first touched or focused: a long page stays quick.
  const ready = new WeakSet();
  const wake = (event) => {
    const draw = event.target instanceof Element ? event.target.closest("[data-read]") : null;
    if (!draw || ready.has(draw)) return;
    ready.add(draw);
    reader(draw);
  };
  document.addEventListener("pointerover", wake);
  document.addEventListener("focusin", wake);

  const tell = (event) => {
    const point = event.target instanceof Element ? event.target.closest("a, .pt") : null;
    const tip = point && point.querySelector("title")?.textContent;
    if (tip && point.closest("figure")) point.closest("figure").querySelector("output").textContent = tip;
  };
  document.addEventListener("pointerover", (event) => { if (event.target.closest(".fig.wide .draw")) tell(event); });
  document.addEventListener("focusin", (event) => { if (event.target.closest(".fig.wide .draw")) tell(event); });

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
