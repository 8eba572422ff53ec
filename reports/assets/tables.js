// Tables: sort by column, filter while typing, save as CSV with the page's digits and one header row.
(() => {
  const { make, named, plain, saveCsv, whose, words } = touchstone;
  // Fewest rows that get a filter.
  const MANY = 8;
  const DASH = "–";
  const SUPER = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹";
  const lowered = (text) => [...text].map((sign) => "-0123456789"[SUPER.indexOf(sign)]).join("");
  // Parse 1.5×10⁻³, 10⁻⁷, 16 619.35, −4.
  const number = (text) => {
    const found = /^([−-]?)(?:([\d\u202f]+(?:\.\d+)?)(?:×10([⁻⁰-⁹¹²³]+))?|10([⁻⁰-⁹¹²³]+))$/.exec(text);
    if (!found) return null;
    const [, sign, digits, power, alone] = found;
    return `${sign ? "-" : ""}${digits ? digits.replaceAll("\u202f", "") : "1"}${power || alone ? `e${lowered(power || alone)}` : ""}`;
  };
  // Units and second numbers of a cell get their own columns; reasons of missing values end the row.
  const reasoned = (cell) => [...cell.querySelectorAll(".none > .sr")].map((part) => plain(part.textContent)).join(" ");
  const said = (cell) => {
    const data = cell.querySelectorAll("data");
    if (data.length === 1 && (cell.dataset.apart || data[0].textContent.trim() === cell.textContent.trim())) return data[0].value;
    const copy = cell.cloneNode(true);
    copy.querySelectorAll("svg, [data-apart]").forEach((part) => part.remove());
    const rest = copy.querySelectorAll("data");
    if (rest.length === 1 && rest[0].textContent.trim() === copy.textContent.trim()) return rest[0].value;
    copy.querySelectorAll(".sub, .sr").forEach((part) => part.prepend(" "));
    const reason = reasoned(copy);
    const text = plain(copy.textContent);
    return text === DASH || (reason && text === `${DASH} ${reason}`) ? "" : number(text) ?? text;
  };
  const reasons = (cells) => [...new Set(cells.filter((cell) => cell && !said(cell)).map(reasoned))].filter(Boolean).join("; ");
  // Header cells above each column, from the top, including spanning ones.
  const heads = (table) => {
    const grid = [];
    [...(table.tHead ? table.tHead.rows : [])].forEach((row, down) => {
      let across = 0;
      for (const cell of row.cells) {
        while (grid[across] && grid[across][down] !== undefined) across += 1;
        for (let column = across; column < across + cell.colSpan; column += 1) {
          grid[column] = grid[column] || [];
          for (let below = down; below < down + cell.rowSpan; below += 1) grid[column][below] = below === down ? cell : null;
        }
        across += cell.colSpan;
      }
    });
    return grid.map((cells) => cells.filter(Boolean));
  };
  const title = (table) => table.dataset.name || words(table.caption).split(/[.:;,(]/)[0].trim() || "table";
  // The cells of a row; spanned columns are empty.
  const placed = (row) => [...row.cells].flatMap((cell) => [cell, ...Array(cell.colSpan - 1).fill(null)]);
  const bodyRows = (table) => [...table.tBodies].flatMap((body) => [...body.rows]);

  const save = (table) => {
    const rows = bodyRows(table).filter((row) => !row.hidden).map(placed);
    const wide = Math.max(0, ...rows.map((cells) => cells.length));
    const apart = Array.from({ length: wide }, (_, place) => [
      ...new Set(rows.flatMap((cells) => (cells[place] ? [...cells[place].querySelectorAll("[data-apart]")] : [])).map((part) => part.dataset.apart)),
    ]);
    const above = heads(table).map((cells) => cells.map(said).filter(Boolean).join(" "));
    const columns = above.length ? above : ["Quantity", title(table), "Note"].slice(0, wide);
    const [why, lacks] = [rows.map(reasons), "Why a value is not there"];
    const head = columns.flatMap((name, place) => [name, ...(apart[place] || []).map((part) => `${name}, ${part}`)]);
    const lines = rows.map((cells, down) => [
      ...cells.flatMap((cell, place) => [cell, ...apart[place].map((part) => cell && cell.querySelector(`[data-apart="${part}"]`))]).map((cell) => (cell ? said(cell) : "")),
      ...(why.some(Boolean) ? [why[down]] : []),
    ]);
    saveCsv(named([...(table.dataset.name ? [] : whose(table)), title(table)], "csv"), [[...head, ...(why.some(Boolean) ? [lacks] : [])], ...lines]);
  };

  // Sort by the words before a cell's first number, then by the number; empty cells come last.
  const key = (cell) => {
    const text = cell ? said(cell) : "";
    const found = /^([^\d]*?)(-?\d[\d.]*(?:e-?\d+)?)?(?=\D|$)/.exec(text);
    return [text === "", found ? found[1].trim() : text, found && found[2] ? Number(found[2]) : -Infinity, text];
  };
  const order = (down) => ([one], [other]) => {
    if (one[0] !== other[0]) return one[0] ? 1 : -1;
    const differs = [1, 2, 3].find((part) => one[part] !== other[part]);
    return differs === undefined ? 0 : (one[differs] < other[differs] ? -1 : 1) * (down ? -1 : 1);
  };
  const sortable = (table) => {
    const columns = heads(table);
    const first = new Map([...table.tBodies].map((body) => [body, [...body.rows]]));
    const lowest = columns.map((cells) => cells[cells.length - 1]);
    lowest.forEach((cell, place) => {
      const button = make("button", { type: "button", className: "sort" });
      button.append(...cell.childNodes);
      cell.append(button);
      button.addEventListener("click", () => {
        // Ascending, descending, original order.
        const next = { ascending: "descending", descending: null }[cell.ariaSort] ?? (cell.ariaSort ? null : "ascending");
        lowest.forEach((other) => other.removeAttribute("aria-sort"));
        if (next) cell.setAttribute("aria-sort", next);
        for (const [body, rows] of first) {
          // A group's header row stays above the group.
          const [above, below] = [rows.filter((row) => row.querySelector("[scope=rowgroup]")), rows.filter((row) => !row.querySelector("[scope=rowgroup]"))];
          const sorted = below.map((row) => [key(placed(row)[place]), row]).sort(order(next === "descending"));
          body.append(...(next ? [...above, ...sorted.map(([, row]) => row)] : rows));
        }
      });
    });
  };
  const filter = (table) => {
    const rows = bodyRows(table).filter((row) => !row.querySelector("[scope=rowgroup]"));
    const count = make("output");
    const input = make("input", { type: "search", placeholder: "Filter", autocomplete: "off", spellcheck: false, ariaLabel: `Filter the rows: ${words(table.caption).slice(0, 80)}` });
    input.addEventListener("input", () => {
      const wanted = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of rows) row.hidden = !wanted.every((word) => row.textContent.toLowerCase().includes(word));
      for (const body of table.tBodies) {
        const [head, ...others] = body.rows;
        if (head && head.querySelector("[scope=rowgroup]")) head.hidden = others.every((row) => row.hidden);
      }
      count.textContent = wanted.length ? `${rows.filter((row) => !row.hidden).length} of ${rows.length}` : "";
    });
    return [input, count];
  };

  for (const table of document.querySelectorAll("table")) {
    const button = make("button", { type: "button", className: "take", ariaLabel: `Save as CSV: ${words(table.caption).slice(0, 80)}` }, "CSV");
    button.addEventListener("click", () => save(table));
    const rows = bodyRows(table).length;
    if (table.tHead && rows > 1) sortable(table);
    const tools = make("span", { className: "tools" }, ...(table.tHead && rows >= MANY ? filter(table) : []), button);
    const frame = table.closest(".scroll");
    if (frame) frame.before(tools); else table.caption.append(" ", tools);
  }
})();
