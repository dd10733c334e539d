"use strict";
// Puts Bokeh's figures into the page, and keeps table, map and panel on one selection.
(async () => {
  const payload = JSON.parse(document.getElementById("payload").textContent);
  const managers = await Bokeh.embed.embed_items(payload.documents, payload.places);
  const models = Bokeh.documents[0];
  const roots = managers.flatMap((manager) => [...manager.roots]);
  const byId = (id) => document.getElementById(id);

  // Print what is seen, at the width of the paper.
  const hosts = Object.entries(payload.places[0].roots);
  window.addEventListener("beforeprint", () => {
    for (const [id, host] of hosts) {
      const view = roots.find((root) => root.model.id === id);
      const still = byId(host.replace("plot-", "still-"));
      still.src = view.export("png", true).canvas.toDataURL();
      still.hidden = false;
      byId(host).classList.add("has-still");
    }
  });
  document.documentElement.dataset.ready = "true";

  const source = models.get_model_by_name("actuators");
  const mapper = models.get_model_by_name("colours");
  const bar = models.get_model_by_name("bar");
  const layers = payload.layers;
  const data = (key) => source.get_column(key);
  const ids = [...data("id")];
  const all = ids.map((_, k) => k);
  const indexOf = new Map(ids.map((id, k) => [id, k]));
  const selected = () => new Set(source.selected.indices);
  const select = (indices) => { source.selected.indices = indices; };

  // Layers of the map.
  const inks = (layer) => Array.from(data(layer.key), (value) => {
    const colours = layer.palette;
    const at = Math.round((value - layer.low) / (layer.high - layer.low) * (colours.length - 1));
    const colour = colours[Math.min(Math.max(at, 0), colours.length - 1)];
    if (!Number.isFinite(value)) return "#595959";
    const [r, g, b] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
    return 0.299 * r + 0.587 * g + 0.114 * b > 128 ? "#000000" : "#ffffff";
  });
  const thin = Math.min(...data("rim_width"));
  const rims = (layer, usual, marked) => {
    const outliers = new Set(layer.outliers);
    return all.map((k) => (outliers.has(k) ? marked : usual));
  };
  const show = (layer) => {
    mapper.setv({ palette: layer.palette, low: layer.low, high: layer.high });
    source.data = { ...Object.fromEntries(source.columns().map((name) => [name, data(name)])),
      shown: data(layer.key), ink: inks(layer), rim: rims(layer, "#1a1a1a", "#a63603"),
      rim_width: rims(layer, thin, 3) };
    models.get_model_by_name("outside").data = layer.outside;
    bar.title = layer.title;
    byId("meaning").textContent = layer.meaning;
  };
  byId("layers").addEventListener("change", (event) => show(layers[Number(event.target.value)]));
  show(layers[0]);

  // One actuator in full.
  const cell = (tag, text) => {
    const element = document.createElement(tag);
    element.textContent = text;
    return element;
  };
  const describe = (k) => {
    const table = document.createElement("table");
    const lines = [["actuator", data("called")[k]], ["ring", data("ring")[k]],
      ["x, y", `${data("x")[k].toFixed(1)}, ${data("y")[k].toFixed(1)} mm`],
      ...layers.map((layer) => [layer.name, `${data(`${layer.key}_text`)[k]} ${layer.unit}`])];
    for (const [name, value] of lines) {
      const row = table.insertRow();
      row.append(cell("th", name), cell("td", value));
      row.firstChild.scope = "row";
    }
    byId("detail").replaceChildren(table);
    byId("which").value = ids[k];
  };
  byId("which").addEventListener("change", (event) => {
    const k = indexOf.get(Number(event.target.value));
    if (k === undefined) {
      byId("detail").replaceChildren(cell("p", `There is no actuator ${event.target.value}.`));
    } else {
      select([k]);
    }
  });
  byId("clear").addEventListener("click", () => select([]));

  // The table: filtered, sorted, a hundred rows at a time.
  const body = document.querySelector("#actuators tbody");
  const fields = ["id", "ring", "x", "y", ...layers.map((layer) => layer.key)];
  const STEP = 100;
  let shown = STEP, sortKey = "id", down = false, matching = all;
  const tests = { "<": (a, b) => a < b, ">": (a, b) => a > b, "<=": (a, b) => a <= b,
    ">=": (a, b) => a >= b, "=": (a, b) => a === b };

  // Returns a test of an actuator, or null where the words are not understood.
  const wanted = (words) => {
    const conditions = [];
    const pattern = /([a-z_]+)\s*(<=|>=|<|>|=)\s*([-+]?[\d.]+(?:e[-+]?\d+)?)/gi;
    const rest = words.replace(pattern, (_, key, sign, number) => {
      conditions.push([key.toLowerCase(), sign, Number(number)]);
      return " ";
    });
    const ranges = [];
    for (const word of rest.split(/[\s,;]+/).filter(Boolean)) {
      const range = /^(\d+)(?:-(\d+))?$/.exec(word);
      if (!range) return null;
      ranges.push([Number(range[1]), Number(range[2] ?? range[1])]);
    }
    if (conditions.some(([key, , number]) => !fields.includes(key) || Number.isNaN(number))) {
      return null;
    }
    return (k) => (ranges.length === 0 || ranges.some(([a, b]) => a <= ids[k] && ids[k] <= b))
      && conditions.every(([key, sign, number]) => tests[sign](data(key)[k], number));
  };
  const row = (k, marked) => {
    const line = document.createElement("tr");
    const texts = [data("called")[k], data("ring")[k], data("x")[k].toFixed(1), data("y")[k].toFixed(1),
      ...layers.map((layer) => data(`${layer.key}_text`)[k])];
    texts.forEach((text, j) => line.append(cell(j ? "td" : "th", text)));
    line.firstChild.scope = "row";
    line.tabIndex = 0;
    line.dataset.index = k;
    line.setAttribute("aria-selected", marked.has(k));
    return line;
  };
  const list = () => {
    const marked = selected();
    const test = wanted(byId("wanted").value);
    byId("wanted").setAttribute("aria-invalid", test === null);
    matching = test === null ? [] : all.filter((k) => test(k) && (!byId("only").checked || marked.has(k)));
    const column = data(sortKey);
    const worth = (k) => (Number.isFinite(column[k]) ? column[k] : Infinity);
    matching.sort((a, b) => (worth(a) === worth(b) ? a - b : (worth(a) < worth(b)) === down ? 1 : -1));
    body.replaceChildren(...matching.slice(0, shown).map((k) => row(k, marked)));
    const part = matching.length > shown ? `, the first ${shown} listed` : "";
    byId("count").textContent = test === null ? "This is not understood."
      : `${matching.length} of ${ids.length} actuator${ids.length === 1 ? "" : "s"}${part}; ${marked.size} selected.`;
    byId("more").hidden = matching.length <= shown;
  };
  const again = () => { shown = STEP; list(); };
  byId("wanted").addEventListener("input", again);
  byId("only").addEventListener("change", again);
  byId("filter").addEventListener("submit", (event) => event.preventDefault());
  byId("more").addEventListener("click", () => { shown += 5 * STEP; list(); });
  for (const head of document.querySelectorAll("#actuators thead th")) {
    head.firstElementChild.addEventListener("click", () => {
      down = sortKey === head.dataset.key && !down;
      sortKey = head.dataset.key;
      document.querySelectorAll("#actuators [aria-sort]").forEach((th) => th.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      list();
    });
  }
  const choose = (event) => {
    const line = event.target.closest("tr");
    if (!line) return;
    const k = Number(line.dataset.index), marked = selected();
    if (event.ctrlKey || event.shiftKey || event.metaKey) {
      marked.has(k) ? marked.delete(k) : marked.add(k);
      select([...marked]);
    } else {
      select(marked.size === 1 && marked.has(k) ? [] : [k]);
    }
    body.querySelector(`[data-index="${k}"]`)?.focus();
  };
  body.addEventListener("click", choose);
  body.addEventListener("keydown", (event) => {
    const move = { ArrowDown: "nextElementSibling", ArrowUp: "previousElementSibling" }[event.key];
    if (move) event.target.closest("tr")[move]?.focus();
    else if (event.key === "Enter" || event.key === " ") choose(event);
    else return;
    event.preventDefault();
  });

  // CSV: what the table lists, with numbers as they are.
  byId("csv").addEventListener("click", () => {
    const heads = ["ID", "RING", "X_mm", "Y_mm", ...layers.map((layer) =>
      layer.key.toUpperCase() + ({ mN: "_mN", "%": "_percent" }[layer.unit] ?? ""))];
    const number = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(7))) : "");
    const lines = matching.map((k) => fields.map((key) => number(data(key)[k])).join(","));
    const text = [heads.join(","), ...lines, ""].join("\n");
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.download = "actuators.csv";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });

  // Selection: from any view to all.
  source.selected.properties.indices.change.connect(() => {
    const [first] = source.selected.indices;
    if (first !== undefined) describe(first);
    list();
  });
  // The pointer over an actuator describes it, without selecting it.
  source.inspect.connect(() => {
    const [first] = source.inspected.indices;
    if (first !== undefined) describe(first);
  });
  describe(0);
  list();
})();
