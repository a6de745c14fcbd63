// Figures enlarge on a click or Enter, and close on the next or on Escape.
const dialog = document.querySelector("dialog");
dialog.onclick = () => dialog.close();
for (const image of document.querySelectorAll("figure img")) {
  image.tabIndex = 0;
  image.onclick = () => { dialog.replaceChildren(image.cloneNode()); dialog.showModal(); };
  image.onkeydown = event => { if (event.key === "Enter") image.click(); };
}

// Tables are sorted by a click on the head of a column, and the other way by the next; those with rows that belong together are not.
const valueOf = cell => {
  const text = cell.innerHTML.replace(/(?:(\S+) × )?10<sup>(.*?)<\/sup>/, (_, mantissa, exponent) => `${mantissa ?? 1}e${exponent}`);
  return parseFloat(text.replaceAll("−", "-").replaceAll(",", ""));
};
const compare = (one, other) => {
  const [first, second] = [valueOf(one), valueOf(other)];
  if (isNaN(first) || isNaN(second)) return isNaN(first) - isNaN(second) || one.textContent.localeCompare(other.textContent);
  return first - second;
};
for (const table of document.querySelectorAll("table")) {
  const body = table.tBodies[0];
  if (body.rows.length < 3 || body.querySelector("[colspan]")) continue;
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.onclick = () => {
      const up = head.ariaSort !== "ascending";
      for (const other of table.tHead.rows[0].cells) other.ariaSort = null;
      head.ariaSort = up ? "ascending" : "descending";
      const rows = [...body.rows].sort((one, other) => compare(one.cells[column], other.cells[column]));
      body.append(...(up ? rows : rows.reverse()));
    };
  });
}

// What is folded away is printed open.
const folded = () => document.querySelectorAll("details:not([open])");
let opened = [];
addEventListener("beforeprint", () => { opened = [...folded()]; opened.forEach(one => { one.open = true; }); });
addEventListener("afterprint", () => { opened.forEach(one => { one.open = false; }); });
