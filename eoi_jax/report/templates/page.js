"use strict";
// A click on a head sorts the rows below it; a second one turns the order round.
const number = (text) => { const found = text.replace("−", "-").match(/^\s*([<>]\s*)?(-?[\d.]+(e[+-]?\d+)?)/i); return found ? parseFloat(found[2]) : NaN; };
const compare = (a, b) => {
  const x = number(a), y = number(b);
  if (isNaN(x) && isNaN(y)) return a.localeCompare(b);
  return isNaN(x) ? 1 : isNaN(y) ? -1 : x - y;
};
for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.parentElement, body = head.closest("table").tBodies[0];
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentElement.children) other.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const cell = (row) => row.cells[head.cellIndex].textContent.trim();
    const rows = [...body.rows].sort((a, b) => (down ? -1 : 1) * compare(cell(a), cell(b)));
    body.append(...rows);
  });
}
addEventListener("beforeprint", () => { for (const one of document.querySelectorAll("details")) one.open = true; });
