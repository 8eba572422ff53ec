// The matrix of scenes and pipelines: filtered by words and verdict, sorted by any column; the address says how, so that a view can be sent.
(() => {
  const table = document.getElementById("matrix-table");
  if (!table) return;
  // As the ladder has them; what is asked of nobody comes last.
  const RANKS = ["holds", "holds with feedback", "undecided", "violates", "no plan", "consistent", "not applicable"];
  const tools = document.querySelector("[data-matrix]");
  const [scene, pipeline, verdict] = ["scene", "pipeline", "verdict"].map((name) => document.getElementById(`matrix-${name}`));
  const count = document.getElementById("matrix-count");
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const columns = [...table.tHead.rows[0].cells].map((cell) => cell.dataset.sort);
  // Without this script there is nothing to press.
  const buttons = [...table.tHead.rows[0].cells].map((cell) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...cell.childNodes);
    cell.append(button);
    return button;
  });
  let sort = { column: "", down: false };

  const rank = (cell) => (cell.dataset.verdict ? RANKS.indexOf(cell.dataset.verdict) : RANKS.length);
  const compare = (column) => {
    const place = columns.indexOf(column);
    if (place === 0) return (one, two) => (one.dataset.name < two.dataset.name ? -1 : 1);
    if (place === 1) return (one, two) => Number(one.cells[1].dataset.holds) - Number(two.cells[1].dataset.holds);
    const cost = (cell) => (cell.dataset.cost ? Number(cell.dataset.cost) : Infinity);
    return (one, two) => {
      const [first, second] = [one.cells[place], two.cells[place]];
      const [cheap, dear] = [cost(first), cost(second)];
      return rank(first) - rank(second) || (cheap === dear ? 0 : cheap - dear);
    };
  };
  const has = (text, words) => words.toLowerCase().split(/\s+/).filter(Boolean).every((word) => text.toLowerCase().includes(word));
  const apply = () => {
    const ordered = [...rows];
    if (columns.includes(sort.column)) {
      ordered.sort(compare(sort.column));
      if (sort.down) ordered.reverse();
    }
    body.append(...ordered);
    for (const cell of table.tHead.rows[0].cells) {
      if (cell.dataset.sort === sort.column) cell.setAttribute("aria-sort", sort.down ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    }
    const wanted = verdict.value;
    const fits = (cell) => !wanted || cell.dataset.verdict === wanted;
    const open = columns.map((name, place) => place < 2 || has(name, scene.value));
    const used = columns.map((_, place) => place < 2);
    let shown = 0;
    for (const row of rows) {
      const named = has(row.dataset.name, pipeline.value);
      let any = 0;
      [...row.cells].forEach((cell, place) => {
        if (place < 2) return;
        const fit = named && open[place] && fits(cell) && Boolean(cell.dataset.verdict);
        cell.classList.toggle("other", !fit);
        if (fit) { any += 1; used[place] = true; }
      });
      row.hidden = !named || (any === 0 && Boolean(wanted || scene.value));
      shown += any;
    }
    const filtered = Boolean(wanted || scene.value || pipeline.value);
    for (const row of [table.tHead.rows[0], ...rows]) {
      [...row.cells].forEach((cell, place) => { cell.hidden = place > 1 && (!open[place] || (filtered && !used[place])); });
    }
    count.textContent = filtered ? `${shown} runs` : "";
  };
  const remember = () => {
    const state = new URLSearchParams();
    for (const [name, value] of [["scene", scene.value], ["pipeline", pipeline.value], ["verdict", verdict.value], ["sort", sort.column]]) if (value) state.set(name, value);
    if (sort.column && sort.down) state.set("order", "down");
    try { history.replaceState(null, "", `#matrix${state.size ? `?${state}` : ""}`); } catch { /* some browsers forbid it for files: the table works without */ }
  };
  const recall = () => {
    // The bare address is that of the whole table.
    if (!/^#matrix(\?|$)/.test(location.hash)) return;
    const state = new URLSearchParams(location.hash.slice(8));
    scene.value = state.get("scene") || "";
    pipeline.value = state.get("pipeline") || "";
    verdict.value = RANKS.includes(state.get("verdict")) ? state.get("verdict") : "";
    const column = columns.includes(state.get("sort")) ? state.get("sort") : "";
    sort = { column, down: state.get("order") === "down" };
    apply();
    document.getElementById("matrix").scrollIntoView();
  };
  const changed = () => { apply(); remember(); };
  [scene, pipeline, verdict].forEach((input) => input.addEventListener("input", changed));
  buttons.forEach((button) => button.addEventListener("click", () => {
    const column = button.closest("th").dataset.sort;
    // First up, then down, then as it was; of what holds most first.
    const first = column === "holds";
    if (sort.column !== column) sort = { column, down: first };
    else if (sort.down === first) sort.down = !first;
    else sort = { column: "", down: false };
    changed();
  }));
  document.getElementById("matrix-reset").addEventListener("click", () => {
    [scene, pipeline, verdict].forEach((input) => { input.value = ""; });
    sort = { column: "", down: false };
    changed();
  });
  tools.hidden = false;
  table.querySelector("[data-sorts]").hidden = false;
  addEventListener("hashchange", recall);
  recall();
})();
