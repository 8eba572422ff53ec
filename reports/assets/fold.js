// Unfolds the parts that a large page keeps compressed, when they are opened, scrolled to or linked to (reports/parcels.py folds them).
(() => {
  // Blocks by name: being inflated, and inflated.
  const [blocks, ready] = [new Map(), new Map()];
  // Path texts from numbers of seven bits a byte: how many lines, how many points each, all x, all y as differences in fifths of a pixel.
  const paths = (bytes) => {
    let place = 0;
    const next = () => {
      let [value, weight] = [0, 1];
      for (;;) {
        const byte = bytes[place];
        place += 1;
        value += (byte & 127) * weight;
        if (byte < 128) return value;
        weight *= 128;
      }
    };
    const signed = () => { const value = next(); return value % 2 ? -(value + 1) / 2 : value / 2; };
    const counts = Array.from({ length: next() }, next);
    const sums = () => counts.map((count) => { let sum = 0; return Array.from({ length: count }, () => (sum += signed())); });
    const [across, down] = [sums(), sums()];
    return across.map((xs, line) => `M${xs.map((x, point) => `${x / 5},${down[line][point] / 5}`).join("L")}`);
  };
  const inflated = async (text) => {
    const raw = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const end = 4 + new DataView(bytes.buffer).getUint32(0, true);
    const words = JSON.parse(new TextDecoder().decode(bytes.subarray(4, end)));
    return { ...words, lines: paths(bytes.subarray(end)) };
  };
  const block = (name) => {
    if (!blocks.has(name)) {
      const text = document.querySelector(`script[data-block="${name}"]`).textContent;
      blocks.set(name, inflated(text).then((contents) => { ready.set(name, contents); return contents; }));
    }
    return blocks.get(name);
  };
  const fragment = (text) => {
    const template = document.createElement("template");
    template.innerHTML = text;
    return template.content;
  };
  const [busy, begun] = [new Set(), new WeakSet()];
  const unfold = (place) => {
    const done = unfolded(place).finally(() => busy.delete(done));
    busy.add(done);
    return done;
  };
  const unfolded = async (place) => {
    if (!place.dataset.part || begun.has(place)) return;
    begun.add(place);
    await block(place.dataset.block);
    fill(place);
  };
  const draw = (spot) => {
    const { figures, lines } = ready.get(spot.dataset.block);
    const figure = fragment(figures[Number(spot.dataset.figure)]);
    figure.querySelectorAll('path[d^="#"]').forEach((path) => path.setAttribute("d", lines[Number(path.getAttribute("d").slice(1))]));
    spot.replaceWith(figure);
  };
  // later: figures and films, the greater part, wait until they are near.
  const fill = (place, later = false) => {
    if (!place.dataset.part) return;
    const part = Number(place.dataset.part);
    delete place.dataset.part;
    const content = fragment(ready.get(place.dataset.block).parts[part]);
    for (const spot of content.querySelectorAll("[data-figure]")) {
      spot.dataset.block = place.dataset.block;
      if (later) near.observe(spot); else draw(spot);
    }
    place.removeAttribute("data-holds");
    place.replaceChildren(content);
    watch(place);
    place.dispatchEvent(new CustomEvent("unfolded", { bubbles: true, detail: { later } }));
  };
  const near = new IntersectionObserver((entries) => {
    entries.filter((entry) => entry.isIntersecting).forEach(({ target }) => {
      near.unobserve(target);
      if (target.dataset.figure) draw(target); else unfold(target);
    });
  }, { rootMargin: "800px 0px" });
  // A place inside closed details has no size and is seen by the observer when they are opened.
  const watch = (root) => root.querySelectorAll(".parcel[data-part]").forEach((place) => near.observe(place));
  watch(document);

  // What unfolds near the place one jumps to moves it: the jump is repeated until it stays. Scrolling on by hand ends that.
  const REPEATS = 20;
  const settle = async (target) => {
    let moved = false;
    const stop = () => { moved = true; };
    ["wheel", "pointerdown", "keydown", "touchstart"].forEach((kind) => addEventListener(kind, stop, { once: true }));
    for (let still = 0, turn = 0; still < 3 && turn < REPEATS && !moved; turn += 1) {
      const before = target.getBoundingClientRect().top;
      target.scrollIntoView({ behavior: "instant" });
      await new Promise((done) => setTimeout(done, 60));
      await Promise.all(busy);
      still = Math.abs(target.getBoundingClientRect().top - before) < 2 ? still + 1 : 0;
    }
  };
  // A link may lead into a part that is folded, or closed.
  const follow = async () => {
    const anchor = location.hash.slice(1).split("?")[0];
    if (!/^[\w-]+$/.test(anchor)) return;
    for (let place = null; (place = document.querySelector(`.parcel[data-holds~="${anchor}"]`)); ) await unfold(place);
    const target = document.getElementById(anchor);
    if (!target) return;
    const whole = target.querySelector(":scope > details.whole");
    if (whole) whole.open = true;
    await Promise.all([...target.querySelectorAll(":scope > .parcel[data-part], :scope > details.whole > .parcel[data-part]")].map(unfold));
    for (let at = target.closest("details"); at; at = at.parentElement.closest("details")) at.open = true;
    await settle(target);
  };
  if (!document.querySelector(".parcel")) return;
  // A smooth scroll would pass, and unfold, all that lies between.
  document.documentElement.classList.add("folded");
  addEventListener("hashchange", follow);
  follow();

  // Printing waits for nothing: blocks are inflated when the page has nothing else to do, so that a part can be put in its place at once.
  const idle = window.requestIdleCallback || ((done) => setTimeout(done, 200));
  const prepare = (names) => {
    if (names.length) idle(() => block(names[0]).finally(() => prepare(names.slice(1))));
  };
  addEventListener("load", () => prepare([...document.querySelectorAll("script[data-block]")].map((item) => item.dataset.block)));
  const folded = (known) => [...document.querySelectorAll(".parcel[data-part]")].filter((place) => known(place.dataset.block));
  // Motion, stages and log of hundreds of runs would be a thousand pages: of those, paper has what is open.
  document.addEventListener("printing", () => {
    const wanted = () => folded((name) => ready.has(name)).filter((place) => !place.closest("details.whole:not([open])"));
    for (let places = wanted(); places.length; places = wanted()) places.forEach((place) => fill(place));
    [...document.querySelectorAll("i[data-figure]")].filter((spot) => !spot.closest("details.whole:not([open])")).forEach(draw);
  });
  // Browsers search what is on the page, in closed details too: who is about to search gets the text of every part, one block a turn.
  const search = async () => {
    for (let [place] = folded(() => true); place; [place] = folded(() => true)) {
      const name = place.dataset.block;
      await block(name);
      folded((other) => other === name).forEach((mine) => fill(mine, true));
      await new Promise((done) => setTimeout(done));
    }
  };
  addEventListener("keydown", (event) => {
    if (event.key === "F3" || ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "f")) search();
  });
})();
