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
  const said = (cell) => {
    const data = cell.querySelectorAll("data");
    if (data.length === 1 && data[0].textContent.trim() === cell.textContent.trim()) return data[0].value;
    const copy = cell.cloneNode(true);
    copy.querySelectorAll("button.take, svg").forEach((part) => part.remove());
    copy.querySelectorAll(".sub, .sr").forEach((part) => part.prepend(" "));
    const text = copy.textContent.replace(/[ \n\t]+/g, " ").trim();
    const plain = number(text);
    return plain === null && /^[=+\-@−]/.test(text) && text.length > 1 ? `'${text}` : plain ?? text;
  };
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
  const csv = (table) => {
    const rows = [...table.tBodies].flatMap((body) => [...body.rows]).filter((row) => !row.hidden);
    const lines = rows.map((row) => [...row.cells].filter((cell) => !cell.hidden).map(said));
    const head = heads(table);
    return `${[...(head.length ? [head] : []), ...lines].map((line) => line.map(field).join(",")).join("\r\n")}\r\n`;
  };
  const words = (table) => (table.caption ? table.caption.textContent.trim() : "");
  const name = (table) => (table.dataset.name || words(table)).toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(0, 48) || "table";
  const save = (table) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(["\ufeff", csv(table)], { type: "text/csv" }));
    link.download = `${name(table)}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const offer = (root) => {
    for (const table of root.querySelectorAll("table")) {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "take";
      button.textContent = "CSV";
      button.setAttribute("aria-label", `Download as CSV: ${words(table).slice(0, 80)}`);
      button.addEventListener("click", () => save(table));
      const frame = table.closest(".scroll");
      if (frame) frame.after(button); else if (table.caption) table.caption.append(" ", button); else table.after(button);
    }
  };
  offer(document);
  document.addEventListener("unfolded", (event) => offer(event.target));
})();
