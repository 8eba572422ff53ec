// A button below each table saves it as CSV: numbers with the digits that the page holds, one row of heads, nothing that a spreadsheet would run.
(() => {
  const SUPER = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹";
  const lowered = (text) => [...text].map((sign) => "-0123456789"[SUPER.indexOf(sign)]).join("");
  // 1.5×10⁻³, 10⁻⁷, 16 619.35, −4: as a program reads them.
  const number = (text) => {
    const found = /^([−-]?)(?:([\d\u202f]+(?:\.\d+)?)(?:×10([⁻⁰-⁹¹²³]+))?|10([⁻⁰-⁹¹²³]+))$/.exec(text);
    if (!found) return null;
    const [, sign, digits, power, alone] = found;
    return `${sign ? "-" : ""}${digits ? digits.replaceAll("\u202f", "") : "1"}${power || alone ? `e${lowered(power || alone)}` : ""}`;
  };
  const safe = (text) => number(text) ?? (/^[=+\-@−]/.test(text) && text.length > 1 ? `'${text}` : text);
  const plain = (text) => text.replaceAll("\u00ad", "").replace(/(\d)\u202f(?=\d)/g, "$1").replace(/\s+/g, " ").trim();
  const DASH = "–";
  // What stands apart in a cell, a unit or a second number, gets a column of its own; why a value is not there stands at the end of the row.
  const reasoned = (cell) => [...cell.querySelectorAll(".none > .sr")].map((part) => plain(part.textContent)).join(" ");
  const said = (cell) => {
    const data = cell.querySelectorAll("data");
    if (data.length === 1 && (cell.dataset.apart || data[0].textContent.trim() === cell.textContent.trim())) return data[0].value;
    const copy = cell.cloneNode(true);
    copy.querySelectorAll("button.take, svg, [data-apart]").forEach((part) => part.remove());
    const rest = copy.querySelectorAll("data");
    if (rest.length === 1 && rest[0].textContent.trim() === copy.textContent.trim()) return rest[0].value;
    copy.querySelectorAll(".sub, .sr").forEach((part) => part.prepend(" "));
    const reason = reasoned(copy);
    const text = plain(copy.textContent);
    return text === DASH || (reason && text === `${DASH} ${reason}`) ? "" : safe(text);
  };
  const reasons = (cells) => [...new Set(cells.filter((cell) => cell && !said(cell)).map(reasoned))].filter(Boolean).join("; ");
  const field = (text) => (/[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  // Heads that span rows or columns are spread over what they span and joined.
  const heads = (table) => {
    const grid = [];
    const rows = table.tHead ? [...table.tHead.rows] : [];
    rows.forEach((row, down) => {
      let across = 0;
      for (const cell of row.cells) {
        if (cell.hidden) continue;
        while (grid[across] && grid[across][down] !== undefined) across += 1;
        for (let column = across; column < across + cell.colSpan; column += 1) {
          grid[column] = grid[column] || [];
          for (let below = down; below < down + cell.rowSpan; below += 1) grid[column][below] = below === down ? said(cell) : "";
        }
        across += cell.colSpan;
      }
    });
    return grid.map((words) => words.filter(Boolean).join(" "));
  };
  const words = (table) => {
    if (!table.caption) return "";
    const copy = table.caption.cloneNode(true);
    copy.querySelectorAll("button.take, .sign").forEach((part) => part.remove());
    return plain(copy.textContent);
  };
  const title = (table) => table.dataset.name || words(table).split(/[.:;,(]/)[0].trim() || "table";
  // The cells of a row as they are shown, with nothing below what spans columns.
  const placed = (row) => [...row.cells].filter((cell) => !cell.hidden).flatMap((cell) => [cell, ...Array(cell.colSpan - 1).fill(null)]);
  const csv = (table) => {
    const shown = [...table.tBodies].flatMap((body) => [...body.rows]).filter((row) => !row.hidden);
    const rows = shown.map(placed);
    const wide = Math.max(0, ...rows.map((cells) => cells.length));
    const apart = Array.from({ length: wide }, (_, place) => [
      ...new Set(rows.flatMap((cells) => (cells[place] ? [...cells[place].querySelectorAll("[data-apart]")] : [])).map((part) => part.dataset.apart)),
    ]);
    const named = heads(table);
    const columns = named.length ? named : ["Quantity", safe(title(table)), "Note"].slice(0, wide);
    const [why, lacks] = [rows.map(reasons), "Why a value is not there"];
    const head = columns.flatMap((name, place) => [name, ...(apart[place] || []).map((part) => `${name}, ${part}`)]);
    const lines = rows.map((cells, down) => [
      ...cells.flatMap((cell, place) => [cell, ...apart[place].map((part) => cell && cell.querySelector(`[data-apart="${part}"]`))]).map((cell) => (cell ? said(cell) : "")),
      ...(why.some(Boolean) ? [safe(why[down])] : []),
    ]);
    return `${[[...head, ...(why.some(Boolean) ? [lacks] : [])], ...lines].map((line) => line.map(field).join(",")).join("\r\n")}\r\n`;
  };
  // Whose table it is, where its title does not say so: the run and its stage, or the scene.
  const around = (table) => {
    if (table.dataset.name) return [];
    const run = table.closest("article.run[data-words]");
    const stage = table.closest("details.stage");
    const scene = table.closest(".of-scene");
    const found = [run && run.querySelector("h3"), stage && stage.querySelector("h4"), scene && scene.querySelector("h3")].filter(Boolean).map((heading) => {
      const copy = heading.cloneNode(true);
      copy.querySelectorAll(".sign").forEach((part) => part.remove());
      return plain(copy.textContent).split(/ of \d+:/)[0];
    });
    return found;
  };
  // Whole words, as many as each part of a file's name has room for.
  const LONGEST = 60;
  const slug = (text) => {
    const all = text.toLowerCase().replace(/[^\p{L}\p{N}_]+/gu, "-").replace(/^-|-$/g, "");
    return all.length > LONGEST ? all.slice(0, LONGEST + 1).replace(/-[^-]*$/, "").slice(0, LONGEST) : all;
  };
  const name = (table) => [...around(table), title(table)].map(slug).filter(Boolean).join("-") || "table";
  const save = (table) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(["\ufeff", csv(table)], { type: "text/csv" }));
    link.download = `${name(table)}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  for (const table of document.querySelectorAll("table")) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "take";
    button.textContent = "CSV";
    button.setAttribute("aria-label", `Download as CSV: ${words(table).slice(0, 80)}`);
    button.addEventListener("click", () => save(table));
    const frame = table.closest(".scroll");
    if (frame) frame.after(button); else if (table.caption) table.caption.append(" ", button); else table.after(button);
  }
})();
