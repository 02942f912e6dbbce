"use strict";
// A click on a column header sorts the rows; a second click reverses the order.
const number = (text) => { const match = text.replace("−", "-").match(/^\s*([<>]\s*)?(-?[\d.]+(e[+-]?\d+)?)/i); return match ? parseFloat(match[2]) : NaN; };
const compare = (a, b) => {
  const x = number(a), y = number(b);
  if (isNaN(x) && isNaN(y)) return a.localeCompare(b);
  return isNaN(x) ? 1 : isNaN(y) ? -1 : x - y;
};
for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.parentElement, body = head.closest("table").tBodies[0];
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const header of head.parentElement.children) header.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const cell = (row) => row.cells[head.cellIndex].textContent.trim();
    const rows = [...body.rows].sort((a, b) => (down ? -1 : 1) * compare(cell(a), cell(b)));
    body.append(...rows);
  });
}
addEventListener("beforeprint", () => { for (const details of document.querySelectorAll("details")) details.open = true; });
