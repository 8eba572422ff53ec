// Figures: values at the pointer, zoom, and saving as SVG, PNG or CSV.
(() => {
  const { make, named, save, saveCsv, whose, words } = touchstone;
  const NAMESPACE = "http://www.w3.org/2000/svg";
  const drawn = (name, attributes, text = "") => {
    const element = document.createElementNS(NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = text;
    return element;
  };
  const digits = (value) => {
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2).replace("e", " × 10^").replace("^+", "^").replace("-", "−");
    return Number(value.toPrecision(4)).toString().replace("-", "−");
  };
  const withUnit = (text, unit) => (unit && unit !== "1" ? `${text} ${unit}` : text);

  // The numbers of a plot, packed by reports/plots.py: [xs, ys] of each series.
  const unpacked = async (svg, { x, y }) => {
    const bytes = Uint8Array.from(atob(svg.dataset.v), (sign) => sign.charCodeAt(0));
    const planes = new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());
    const count = planes.length / 8;
    let at = 0;
    const next = () => {
      let whole = 0;
      for (let plane = 7; plane >= 0; plane -= 1) whole = whole * 256 + planes[plane * count + at];
      at += 1;
      return whole % 2 ? -(whole + 1) / 2 : whole / 2;
    };
    const column = ([length, exponent], log) => {
      let [value, step] = [0, 0];
      return Array.from({ length }, () => {
        step += next();
        value += step;
        const number = exponent < 0 ? value / 10 ** -exponent : value * 10 ** exponent;
        return log ? Number((10 ** number).toPrecision(5)) : number;
      });
    };
    const heads = Array.from({ length: next() }, () => [[next(), next()], [next(), next()]]);
    let xs = [];
    return heads.map((head) => {
      if (head[0][0]) xs = column(head[0], x[4]);
      return [xs, column(head[1], y[4])];
    });
  };
  // Pixel of a value on an axis, and value of a pixel.
  const onto = ([low, high, start, end, log], value) => start + (log ? Math.log(Math.max(value, 1e-200) / low) / Math.log(high / low) : (value - low) / (high - low)) * (end - start);
  const back = ([low, high, start, end, log], pixel) => {
    const part = (pixel - start) / (end - start);
    return log ? low * (high / low) ** part : low + part * (high - low);
  };
  // Linear interpolation of a line at x; null outside.
  const between = ([xs, ys], x, reach) => {
    const last = xs.length - 1;
    if (x < xs[0] - reach || x > xs[last] + reach) return null;
    let [low, high] = [0, last];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (xs[middle] <= x) low = middle; else high = middle;
    }
    const part = xs[high] > xs[low] ? Math.min(Math.max((x - xs[low]) / (xs[high] - xs[low]), 0), 1) : 0;
    return ys[low] + part * (ys[high] - ys[low]);
  };
  // Round numbers that divide a span into about this many parts, with enough digits to differ.
  const ticks = (low, high, parts) => {
    const raw = (high - low) / parts;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 2.5, 5, 10].map((nice) => nice * power).find((nice) => nice >= raw * 0.999);
    const places = Math.min(Math.max(0, 1 - Math.floor(Math.log10(step))), 20);
    const first = Math.ceil(low / step - 1e-9);
    return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, place) => [(first + place) * step, Number(((first + place) * step).toFixed(places)).toString().replace("-", "−")]);
  };

  const figure = (svg) => {
    const frame = svg.closest("figure, .film");
    const area = svg.closest("[data-read]");
    const title = words(frame.querySelector("figcaption strong")) || (frame.querySelector("[aria-label]") || {}).ariaLabel || "figure";
    const axes = svg.dataset.axes ? JSON.parse(svg.dataset.axes) : null;
    const output = axes && make("output", { className: "readout", ariaLive: "polite" });
    if (output) svg.closest(".draw").after(output);
    const lines = [...svg.querySelectorAll("path[data-n]")];
    let waiting = null;
    const series = () => (waiting ||= unpacked(svg, axes));
    // The axis as shown, and the original.
    let shown = axes && axes.x;

    const tell = (told, left, top) => {
      output.replaceChildren(...told.map((line) => make("span", {}, line)));
      const [box, around] = [svg.getBoundingClientRect(), frame.getBoundingClientRect()];
      const scale = box.width / svg.viewBox.baseVal.width;
      const [x, y] = [box.left - around.left + left * scale, box.top - around.top + top * scale];
      const [wide, tall] = [output.offsetWidth, output.offsetHeight];
      output.style.left = `${Math.max(0, x + 14 + wide <= around.width ? x + 14 : Math.min(x - 14 - wide, around.width - wide))}px`;
      output.style.top = `${Math.max(0, y - tall / 2)}px`;
    };
    let marks = null;
    let at = null;
    const clear = () => {
      if (marks) marks.remove();
      [marks, at] = [null, null];
      output.replaceChildren();
    };
    const read = async (pixel, top = null) => {
      if (!lines.length) return;
      at = Math.min(Math.max(pixel, shown[2]), shown[3]);
      const wanted = at;
      const all = await series();
      if (at !== wanted) return;
      if (marks) marks.remove();
      marks = drawn("g", { class: "marks" });
      marks.append(drawn("path", { class: "cursor", d: `M${at},${axes.y[3]}V${axes.y[2]}` }));
      const x = back(shown, at);
      const told = [withUnit(`${axes.q[0]} ${digits(x)}`, axes.q[1])];
      lines.forEach((line, place) => {
        const y = between(all[place], x, Math.abs(back(shown, at + 0.6) - x));
        if (y === null) return;
        told.push(withUnit(`${line.dataset.n} ${digits(y)}`, line.matches(".level") ? "" : axes.q[3]));
        const bead = drawn("circle", { class: `bead ${line.getAttribute("class").replace("ln ", "")}`, cx: at, cy: onto(axes.y, y), r: 3 });
        marks.append(bead);
      });
      svg.append(marks);
      tell(told, at, top ?? (axes.y[2] + axes.y[3]) / 2);
    };
    const place = (event) => {
      const box = svg.getBoundingClientRect();
      const scale = svg.viewBox.baseVal.width / box.width;
      return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    };

    // The original is kept; a double click restores it.
    const written = [];
    const restore = () => {
      written.splice(0).forEach((undo) => undo());
      shown = axes.x;
    };
    const enlarge = async (low, high) => {
      const all = await series();
      restore();
      const [start, end] = [axes.x[2], axes.x[3]];
      const change = (element, name, value) => {
        const before = element.getAttribute(name);
        element.setAttribute(name, value);
        written.push(() => (before === null ? element.removeAttribute(name) : element.setAttribute(name, before)));
      };
      const seen = (x) => Math.min(Math.max(onto(shown, x), start), end);
      shown = [low, high, start, end, 0];
      lines.forEach((line, place) => {
        const [xs, ys] = all[place];
        const inside = xs.map((x, point) => [x, ys[point]]).filter(([x]) => x > low && x < high);
        const ends = [low, high].map((x) => [x, between(all[place], x, 0)]).filter(([, y]) => y !== null);
        const points = [...ends.filter(([x]) => x === low), ...inside, ...ends.filter(([x]) => x === high)];
        change(line, "d", points.length ? `M${points.map(([x, y]) => `${seen(x).toFixed(1)},${onto(axes.y, y).toFixed(1)}`).join("L")}` : "M0,0");
      });
      svg.querySelectorAll("rect:not(.pt *)").forEach((bar) => {
        const [from, wide] = [Number(bar.getAttribute("x")), Number(bar.getAttribute("width"))];
        const [left, right] = [seen(back(axes.x, from)), seen(back(axes.x, from + wide))];
        change(bar, "x", left);
        change(bar, "width", right - left);
      });
      svg.querySelectorAll("text.tag:not(.small)").forEach((tag) => change(tag, "visibility", "hidden"));
      const marked = ticks(low, high, Math.max(3, Math.floor((end - start) / 62)));
      change(svg.querySelector(".grid.x"), "d", marked.map(([x]) => `M${seen(x)},${axes.y[3]}V${axes.y[2]}`).join(""));
      const below = svg.querySelector(".tick.x");
      const former = [...below.childNodes];
      written.push(() => below.replaceChildren(...former));
      below.replaceChildren(...marked.map(([x, said]) => drawn("text", { x: seen(x), y: axes.y[2] + 15 }, said)));
    };
    if (area) {
      let from = null;
      let span = null;
      area.addEventListener("pointerdown", (event) => {
        if (event.button === 0 && event.pointerType !== "touch") [from] = place(event);
      });
      area.addEventListener("pointermove", (event) => {
        const [x, y] = place(event);
        if (from !== null && event.buttons) {
          const [left, right] = [Math.max(Math.min(from, x), axes.x[2]), Math.min(Math.max(from, x), axes.x[3])];
          span ||= svg.appendChild(drawn("rect", { class: "span", y: axes.y[3], height: axes.y[2] - axes.y[3] }));
          span.setAttribute("x", left);
          span.setAttribute("width", Math.max(0, right - left));
        }
        if (!event.target.closest(".pt")) read(x, y);
      });
      const released = (event) => {
        if (span) span.remove();
        const [begin, until] = [from, place(event)[0]].map((pixel) => Math.min(Math.max(pixel, axes.x[2]), axes.x[3])).sort((one, other) => one - other);
        // Shorter moves are clicks.
        if (span && until - begin > 5 && !axes.x[4]) enlarge(back(shown, begin), back(shown, until)).then(clear);
        [from, span] = [null, null];
      };
      area.addEventListener("pointerup", released);
      area.addEventListener("dblclick", () => { restore(); clear(); });
      area.addEventListener("pointerleave", () => { if (span) span.remove(); [from, span] = [null, null]; clear(); });
      area.addEventListener("blur", clear);
      area.addEventListener("keydown", (event) => {
        const [low, high] = [axes.x[2], axes.x[3]];
        const stride = (high - low) / (event.shiftKey ? 10 : 100);
        const target = { ArrowRight: at === null ? low : at + stride, ArrowLeft: at === null ? high : at - stride, Home: low, End: high }[event.key];
        if (event.key === "Escape") { restore(); clear(); }
        if (target === undefined) return;
        event.preventDefault();
        read(target);
      });
    }
    // Points have our tip; the browser's would cover it.
    for (const point of svg.querySelectorAll(".pt")) {
      const name = point.querySelector("title");
      point.dataset.tip = name.textContent;
      if (point.matches("a")) point.setAttribute("aria-label", name.textContent);
      name.remove();
    }
    const point = (event) => {
      const found = event.target.closest(".pt");
      if (!found || !output) return;
      const box = found.getBBox();
      tell([found.dataset.tip], box.x + box.width, box.y + box.height / 2);
    };
    ["pointerover", "focusin"].forEach((kind) => svg.addEventListener(kind, point));
    ["pointerout", "focusout"].forEach((kind) => svg.addEventListener(kind, (event) => { if (event.target.closest(".pt") && !area) clear(); }));

    const rows = async () => {
      const all = await series();
      const heads = [[0, 1], [2, 3]].map(([quantity, unit]) => (axes.q[unit] ? `${axes.q[quantity]} [${axes.q[unit]}]` : axes.q[quantity]));
      const points = [...svg.querySelectorAll(".pt")];
      const named = [...lines.map((line) => line.dataset.n), ...(points.length ? [null] : [])];
      const data = named.flatMap((name, place) => all[place][0].map((x, point) => [name ?? points[point].dataset.tip, x, all[place][1][point]]));
      return [["series", ...heads], ...data];
    };
    const name = (ending) => {
      const parts = whose(frame);
      return named([...(parts.length ? parts : [words(document.querySelector("h1"), ".badge")]), title, ...(axes && axes.q[3] ? [axes.q[3]] : [])], ending);
    };
    return {
      point,
      csv: axes && (async () => saveCsv(name("csv"), await rows())),
      svg: () => save(name("svg"), new Blob([standing(svg, frame, title).text], { type: "image/svg+xml" })),
      png: async () => save(name("png"), await picture(standing(svg, frame, title))),
    };
  };

  // Copy the page's style to attributes of a drawing.
  const TAKEN = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linejoin", "paint-order", "font-family", "font-size", "font-weight", "text-anchor", "visibility"];
  const styled = (original, copy, above) => {
    const style = getComputedStyle(original);
    const own = Object.fromEntries(TAKEN.map((name) => [name, style.getPropertyValue(name)]));
    for (const name of TAKEN) if (own[name] !== above[name]) copy.setAttribute(name, own[name]);
    [...original.children].forEach((child, place) => styled(child, copy.children[place], own));
    ["class", "focusable", "aria-hidden", "data-axes", "data-v", "tabindex"].forEach((gone) => copy.removeAttribute(gone));
  };
  // Keys of the nearest legend that occur in this plot.
  const keys = (svg, frame) => {
    const within = frame.closest(".stage-body, section") || document.body;
    const lists = [...within.querySelectorAll("ul.legend")].filter((list) => list.querySelector(".swatch"));
    const before = lists.filter((list) => list.compareDocumentPosition(frame) & Node.DOCUMENT_POSITION_FOLLOWING);
    const legend = before.length ? before[before.length - 1] : lists[0];
    if (!legend) return [];
    const has = (item) => {
      const mark = item.querySelector(".swatch > *");
      const wanted = [...mark.classList];
      return [...svg.querySelectorAll(`.${CSS.escape(wanted[0])}`)].some((element) => wanted.every((name) => element.classList.contains(name)));
    };
    return [...legend.querySelectorAll("li")].filter((item) => item.querySelector(".swatch > *") && has(item));
  };
  // A standalone drawing: title above, keys below, light colours on white.
  const standing = (svg, frame, title) => {
    const { width, height } = svg.viewBox.baseVal;
    document.documentElement.classList.add("light");
    const root = drawn("svg", { xmlns: NAMESPACE, "font-family": "sans-serif", "font-size": "12px" });
    svg.querySelectorAll(".marks, .span").forEach((mark) => mark.remove());
    const copy = svg.cloneNode(true);
    styled(svg, copy, {});
    [...copy.querySelectorAll("title")].forEach((part) => part.remove());
    const [TOP, ROW] = [26, 20];
    let [x, y] = [10, TOP + height + 4];
    const below = keys(svg, frame).flatMap((item) => {
      const swatch = item.querySelector(".swatch");
      const sample = swatch.cloneNode(true);
      styled(swatch, sample, {});
      const said = words(item);
      const wide = 28 + 6 + said.length * 6.6 + 14;
      if (x + wide > width && x > 10) [x, y] = [10, y + ROW];
      sample.setAttribute("x", x);
      sample.setAttribute("y", y);
      const text = drawn("text", { x: x + 34, y: y + 10 }, said);
      x += wide;
      return [sample, text];
    });
    document.documentElement.classList.remove("light");
    const tall = below.length ? y + ROW : TOP + height;
    for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${tall}`, width, height: tall })) root.setAttribute(key, value);
    copy.setAttribute("y", TOP);
    copy.setAttribute("width", width);
    copy.setAttribute("height", height);
    root.append(drawn("title", {}, title), drawn("rect", { width: "100%", height: "100%", fill: "#fff" }), drawn("text", { x: 2, y: 16, "font-size": "13px", "font-weight": "600" }, title), copy, ...below);
    return { text: new XMLSerializer().serializeToString(root), width, height: tall };
  };
  // Twice the resolution, for print and sharp screens.
  const FINE = 2;
  const picture = async ({ text, width, height }) => {
    const image = new Image();
    image.src = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
    await image.decode();
    const canvas = make("canvas", { width: FINE * width, height: FINE * height });
    canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
    URL.revokeObjectURL(image.src);
    return new Promise((done) => { canvas.toBlob(done, "image/png"); });
  };

  // Listeners are added on first use, which keeps long pages fast.
  const ready = new WeakMap();
  const awake = (svg) => {
    if (!ready.has(svg)) ready.set(svg, figure(svg));
    return ready.get(svg);
  };
  const wake = (event) => {
    const svg = event.target instanceof Element && (event.target.closest("svg.plot") || (event.target.closest(".draw") || event.target).querySelector(":scope > svg.plot"));
    if (!svg || !svg.closest("figure") || ready.has(svg)) return;
    awake(svg).point(event);
  };
  document.addEventListener("pointerover", wake);
  document.addEventListener("focusin", wake);
  for (const svg of document.querySelectorAll("figure svg.plot, .film svg.plot")) {
    const frame = svg.closest("figure, .film");
    const kinds = svg.dataset.v ? ["svg", "png", "csv"] : ["svg", "png"];
    const buttons = kinds.map((kind, place) => {
      const button = make("button", { type: "button", tabIndex: place ? -1 : 0 }, kind.toUpperCase());
      button.addEventListener("click", () => awake(svg)[kind]());
      return button;
    });
    const bar = make("span", { className: "save tools" }, ...buttons);
    bar.setAttribute("role", "toolbar");
    bar.setAttribute("aria-label", `Save the figure: ${words(frame.querySelector("figcaption strong"))}`);
    bar.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step) buttons[(buttons.indexOf(document.activeElement) + step + buttons.length) % buttons.length].focus();
    });
    (frame.querySelector("figcaption") || frame).append(bar);
  }
})();
