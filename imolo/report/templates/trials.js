// The list of trials: filter and sort.

const list = byId("list"), body = list.tBodies[0], filters = byId("filters");
const rows = [...body.rows].map((row) => ({ row, text: row.textContent.toLowerCase().replace(/\s+/g, " ") }));

function applyFilters() {
  const chosen = Object.fromEntries(new FormData(filters));
  const words = chosen.text.toLowerCase().split(/\s+/).filter(Boolean);
  // "ball 3" is one word: ball 13 is another ball.
  const phrases = words.join(" ").match(/ball \d+|\S+/g) || [];
  let count = 0;
  for (const { row, text } of rows) {
    const fits = ["backend", "method", "outcome"].every((key) => !chosen[key] || row.dataset[key] === chosen[key])
      && phrases.every((phrase) => (/^ball \d/.test(phrase) ? ` ${text} `.includes(` ${phrase} `) : text.includes(phrase)));
    row.hidden = !fits;
    count += fits;
  }
  byId("count").textContent = `${count} of ${rows.length}`;
  byId("nothing").hidden = count > 0;
}

function sortBy(header) {
  const column = header.cellIndex, down = header.getAttribute("aria-sort") === "ascending";
  for (const other of header.parentNode.cells) if (other.hasAttribute("aria-sort")) other.setAttribute("aria-sort", "none");
  header.setAttribute("aria-sort", down ? "descending" : "ascending");
  const value = ({ row }) => { const cell = row.cells[column]; return cell.dataset.value === undefined ? cell.textContent.trim() : cell.dataset.value; };
  const compare = (a, b) => {
    const [x, y] = [value(a), value(b)];
    // What has no value comes last either way.
    if (x === "" || y === "") return (x === "") - (y === "");
    const order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
    return down ? -order : order;
  };
  body.append(...[...rows].sort(compare).map(({ row }) => row));
}

filters.addEventListener("input", applyFilters);
filters.addEventListener("submit", (event) => event.preventDefault());
for (const header of list.tHead.rows[0].cells) header.querySelector("button")?.addEventListener("click", () => sortBy(header));
applyFilters();
