/* Tables that sort by a click on the head of a column. */
"use strict";

const keyOf = cell => {
    const key = cell?.dataset.sort ?? cell?.textContent ?? "", number = Number(key);
    return key !== "" && Number.isFinite(number) ? number : key;
};

function sortBy(table, column, falling) {
    const rows = [...table.tBodies[0].rows], sign = falling ? -1 : 1;
    rows.sort((a, b) => {
        const [p, q] = [keyOf(a.cells[column]), keyOf(b.cells[column])];
        if (typeof p !== typeof q) return typeof p === "number" ? -1 : 1;
        return sign * (typeof p === "number" ? p - q : p.localeCompare(q, "en", { numeric: true }));
    });
    table.tBodies[0].append(...rows);
    [...table.tHead.rows[0].cells].forEach((head, k) => (k === column
        ? head.setAttribute("aria-sort", falling ? "descending" : "ascending") : head.removeAttribute("aria-sort")));
}

document.addEventListener("click", event => {
    const head = event.target.closest("table.sorts th");
    if (head) sortBy(head.closest("table"), head.cellIndex, head.getAttribute("aria-sort") === "ascending");
});
