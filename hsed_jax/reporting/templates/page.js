// The script of the page: contents, theme, and the charts with the chosen experiment.
"use strict";
(() => {
  const content = JSON.parse(document.getElementById("content").textContent);
  const root = document.documentElement;

  // Contents: every section with a heading.
  const nav = document.querySelector("nav");
  for (const section of document.querySelectorAll("main > section[id]")) {
    const link = document.createElement("a");
    link.href = `#${section.id}`;
    link.textContent = section.dataset.short || section.querySelector("h2").textContent;
    nav.append(link);
  }

  // Light or dark: the setting of the system, until the reader changes it.
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const paint = (dark) => { root.dataset.theme = dark ? "dark" : "light"; };
  paint(system.matches);
  system.addEventListener("change", (event) => paint(event.matches));
  document.getElementById("theme").addEventListener("click", () => paint(root.dataset.theme !== "dark"));

  // Open all folded parts for printing.
  window.addEventListener("beforeprint", () => document.querySelectorAll("main details").forEach((d) => { if (!d.closest(".chart")) d.open = true; }));

  // The tables are stored as columns; charts need rows.
  const rows = (table) => {
    const names = Object.keys(table);
    return names.length ? table[names[0]].map((_, i) => Object.fromEntries(names.map((name) => [name, table[name][i]]))) : [];
  };
  const tables = Object.fromEntries(Object.entries(content.tables).map(([name, table]) => [name, rows(table)]));

  const named = (specification, found = new Set()) => {
    if (specification && typeof specification === "object") {
      if (specification.data && specification.data.name) found.add(specification.data.name);
      Object.values(specification).forEach((part) => named(part, found));
    }
    return found;
  };

  // The first shown experiment is the worst one of the first model.
  const compared = (tables.experiments || []).filter((row) => row.model === "before");
  const first = compared.length ? compared.reduce((a, b) => (b.error > a.error ? b : a)).experiment : "";

  const views = {};
  const embed = async (name, specification) => {
    const datasets = { ...specification.datasets };
    for (const table of named(specification)) if (table in tables) datasets[table] = tables[table];
    const params = (specification.params || []).map((param) => (param.name === "experiment" ? { ...param, value: first } : param));
    const options = { renderer: "svg", actions: { export: true, source: false, compiled: false, editor: false }, downloadFileName: name };
    const { view } = await vegaEmbed(`#chart-${name}`, { ...specification, params, datasets }, options);
    views[name] = view;
  };

  // The chosen experiment, in every chart with an experiment.
  const select = document.getElementById("experiment");
  const choose = (id) => {
    if (!select || ![...select.options].some((option) => option.value === id)) return;
    select.value = id;
    for (const view of Object.values(views)) {
      if (Object.hasOwn(view.getState().signals, "experiment")) view.signal("experiment", id).runAsync();
    }
    const own = tables.experiments.filter((row) => row.experiment === id);
    const model = { before: "as it was", after: "improved", remainder: "with the remainder" };
    const errors = own.map((row) => `error ${row.error === null ? "diverged" : row.error.toFixed(3)}${own.length > 1 ? ` ${model[row.model]}` : ""}`);
    document.getElementById("about").textContent = own.length ? `${own[0].split}; ${errors.join(", ")}` : "";
  };
  const step = (by) => {
    const count = select.options.length;
    choose(select.options[(select.selectedIndex + by + count) % count].value);
  };
  const chooser = () => {
    const seen = tables.samples && tables.samples.length ? tables.samples : tables.experiments;
    for (const id of new Set(seen.map((row) => row.experiment))) select.add(new Option(id, id));
    select.addEventListener("change", () => choose(select.value));
    document.getElementById("previous").addEventListener("click", () => step(-1));
    document.getElementById("next").addEventListener("click", () => step(1));
    choose(first);
  };

  const ready = Promise.all(Object.entries(content.charts).map(([name, specification]) => embed(name, specification)));
  ready.then(() => {
    if (select) chooser();
    if (views.where && select) {
      views.where.addEventListener("click", (_, item) => {
        if (item && item.datum && item.datum.experiment) {
          choose(item.datum.experiment);
          document.getElementById("histories").scrollIntoView();
        }
      });
    }
    root.dataset.ready = "true";
  });
})();
