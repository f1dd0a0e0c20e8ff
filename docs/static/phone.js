// Marks the tables that are wider than the page, and tells each cell its column; phone.css shows their rows as lists.
for (const event of ["load", "resize"])
  addEventListener(event, () => {
    for (const table of document.querySelectorAll("table.docutils")) {
      table.classList.remove("rows-as-lists");
      if (table.parentElement.scrollWidth <= table.parentElement.clientWidth || !table.tHead) continue;
      table.classList.add("rows-as-lists");
      const columns = [...table.tHead.rows[0].cells].map((head) => head.textContent.trim());
      for (const row of table.tBodies[0].rows)
        [...row.cells].forEach((cell, index) => (cell.dataset.column = columns[index]));
    }
  });
