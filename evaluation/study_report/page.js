"use strict";
// Pages of single trials: #trial-ID shows one, drawn from the compact data at the end of the file.
(() => {
  const section = document.getElementById("trial");
  const main = document.getElementById("study");
  let study = null;
  const blocks = new Map();

  function known() {
    if (study === null) {
      study = JSON.parse(document.getElementById("data").textContent);
      study.of = new Map();
      study.order = [];
      study.pairs.forEach((pair, number) => pair.ids.forEach((id, row) => {
        study.of.set(id, [number, row]);
        study.order.push(id);
      }));
    }
    return study;
  }

  async function block(number) {
    if (!blocks.has(number)) {
      const bytes = Uint8Array.from(atob(study.pairs[number].data), (c) => c.charCodeAt(0));
      const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
      blocks.set(number, JSON.parse(await new Response(stream).text()));
    }
    return blocks.get(number);
  }

  function values(steps) {
    if (!steps || steps.length < 3) return [];
    let at = 0;
    return steps.slice(2).map((d) => d === null ? NaN : steps[0] + steps[1] * (at += d));
  }

  function make(name, attributes, ...children) {
    const svg = ["svg", "path", "text", "title", "desc"].includes(name);
    const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", name)
      : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  const three = (value) => value === null ? "–" : String(Number(value.toPrecision(3))).replace("-", "−");

  function ticks(low, high, least) {
    const raw = Math.max((high - low) / 5, least), power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw * 0.999);
    const found = [];
    for (let k = Math.ceil(low / step); k <= high / step; k++) found.push(k * step);
    return found;
  }

  // lines: [{xs, ys, class, dots}]; equal keeps metres alike on both axes.
  function chart(title, description, xlabel, ylabel, lines, { equal = false, zero = false, log = false } = {}) {
    const finite = (list) => list.filter(Number.isFinite);
    const allX = finite(lines.flatMap((l) => l.xs)), allY = finite(lines.flatMap((l) => l.ys));
    if (!allX.length || !allY.length) return null;
    const ends = (list) => [list.reduce((a, b) => Math.min(a, b)), list.reduce((a, b) => Math.max(a, b))];
    let [x0, x1] = ends(allX), [y0, y1] = ends(allY);
    const room = 0.05 * (y1 - y0) || 0.5 * Math.abs(y1) || 1;
    y1 += room; y0 = zero ? Math.min(0, y0) : y0 - room;
    if (!equal) x0 = Math.min(0, x0);
    if (!(x1 > x0)) x1 = x0 + (Math.abs(x0) || 1);
    const upright = ticks(y0, y1, log && y1 - y0 > 1.5 ? 1 : 0), shown = upright.map((y) => three(log ? 10 ** y : y));
    const W = 460, L = Math.max(56, 28 + 7.4 * Math.max(0, ...shown.map((s) => s.length))), R = 14, T = 10, B = 44, w = W - L - R;
    let h = 220;
    if (equal) {
      const xr = 0.04 * (x1 - x0); x0 -= xr; x1 += xr;
      h = Math.min(460, w * (y1 - y0) / (x1 - x0));
      const more = (w * (y1 - y0) / h - (x1 - x0)) / 2;
      x0 -= more; x1 += more;
    }
    const px = (x) => L + w * (x - x0) / (x1 - x0), py = (y) => T + h * (1 - (y - y0) / (y1 - y0));
    const svg = make("svg", { viewBox: `0 0 ${W} ${h + T + B}`, role: "img", "aria-label": `${title}. ${description}` },
      make("title", {}, title), make("desc", {}, description));
    let grid = "";
    const word = (x, y, text, anchor, cls) =>
      svg.append(make("text", { x: x.toFixed(1), y: y.toFixed(1), "text-anchor": anchor, class: cls || "" }, text));
    for (const tick of ticks(x0, x1, 0)) {
      grid += `M${px(tick).toFixed(1)} ${T}v${h}`;
      word(px(tick), T + h + 16, three(tick), "middle");
    }
    upright.forEach((tick, k) => {
      grid += `M${L} ${py(tick).toFixed(1)}h${w}`;
      word(L - 7, py(tick) + 4, shown[k], "end");
    });
    svg.append(make("path", { class: "grid", d: grid }));
    word(L + w / 2, T + h + B - 8, xlabel, "middle", "label");
    svg.append(make("text", { class: "label", "text-anchor": "middle",
      transform: `translate(13 ${T + h / 2}) rotate(-90)` }, ylabel));
    for (const line of lines) {
      let d = "", pen = false;
      line.xs.forEach((x, k) => {
        const y = line.ys[k];
        if (!Number.isFinite(x) || !Number.isFinite(y)) { pen = false; return; }
        const r = line.ring, ring = r ? `m${-r} 0a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0` : "";
        d += `${pen && !line.dots && !r ? "L" : "M"}${px(x).toFixed(1)} ${py(y).toFixed(1)}${line.dots ? "h0" : ring}`;
        pen = true;
      });
      const width = line.dots ? { "stroke-width": line.dots } : {};
      svg.append(make("path", { class: `${line.dots ? "dots" : line.ring ? "ring" : "line"} ${line.class}`, d, ...width }));
    }
    return make("figure", {}, svg, make("figcaption", {}, `${title}, ${description}`));
  }

  function points(list) { return { xs: values(list[0]), ys: values(list[1]) }; }

  function figures(trial, shared) {
    const found = [];
    if (trial.path && trial.path.length) {
      const lines = [];
      if (shared && shared.path.length) lines.push({ ...points(shared.path), class: "truth" });
      if (shared && shared.landmarks.length) lines.push({ ...points(shared.landmarks), class: "truth", ring: 3.4 });
      lines.push({ ...points(trial.path), class: "c0" });
      if (trial.landmarks.length) lines.push({ ...points(trial.landmarks), class: "c1", dots: 3.4 });
      found.push(chart("Map and path", "truth in grey (rings), the estimated path and the mapped landmarks (dots) in colour.",
        "x (m)", "y (m)", lines, { equal: true }));
    }
    const s = trial.series;
    if (s) {
      const t = values(s.t), time = "time since the start (s)";
      const one = (title, what, unit, ys, options) =>
        found.push(chart(title, what, time, unit, [{ xs: t, ys, class: "c0" }], options));
      one("Position error", "after rigid alignment, the largest since the sample before.", "error (m)", values(s.p), { zero: true });
      one("Heading error", "the largest since the sample before.", "error (deg)", values(s.h), { zero: true });
      one("NEES of the pose", "about its degrees of freedom where covariances are honest.", "NEES", values(s.n), { log: true });
    }
    return found.filter((each) => each !== null);
  }

  function table(trial) {
    const body = make("tbody", {});
    study.metrics.forEach(([name, unit, better], k) => {
      if (trial.values[k] === null) return;
      body.append(make("tr", {}, make("th", { scope: "row" }, name),
        make("td", {}, three(trial.values[k])), make("td", { class: "words" }, unit), make("td", { class: "words" }, better)));
    });
    const head = make("tr", {}, ...["metric", "value", "unit", "better"].map((n, k) => make("th", { scope: "col", class: k > 1 ? "words" : "" }, n)));
    return make("div", { class: "scroll" }, make("table", {}, make("caption", {}, "What was measured"), make("thead", {}, head), body));
  }

  function facts(trial, id) {
    const list = make("dl", {});
    const add = (name, value) => list.append(make("dt", {}, name), make("dd", {}, value));
    add("status", trial.status);
    if (trial.reason) add("reason", trial.reason);
    add("source", trial.source);
    for (const [key, value] of trial.options) add(key, value);
    add("took", `${three(trial.wall)} s, CPU ${three(trial.cpu)} s, memory at most ${three(trial.memory)} MB`);
    add("run it alone", make("code", {}, study.again.replaceAll("{id}", id)));
    return list;
  }

  function links(number, row, block) {
    const at = study.order.indexOf(study.pairs[number].ids[row]);
    const to = (id, text) => make("a", { href: `#trial-${id}` }, text);
    const bar = make("nav", { "aria-label": "Trials" }, make("a", { href: "#trials" }, "← all trials"));
    if (at > 0) bar.append(to(study.order[at - 1], "previous"));
    if (at + 1 < study.order.length) bar.append(to(study.order[at + 1], "next"));
    const same = make("p", { class: "note" }, "On the same measurements: ");
    study.pairs[number].ids.forEach((id, k) => {
      if (k !== row) same.append(to(id, block.trials[k].estimator), " ");
    });
    return [bar, same];
  }

  async function show() {
    const id = location.hash.startsWith("#trial-") ? location.hash.slice(7) : "";
    const place = id ? known().of.get(id) : undefined;
    main.hidden = Boolean(id);
    section.hidden = !id;
    if (!id) {
      const target = location.hash.length > 1 ? document.getElementById(location.hash.slice(1)) : null;
      if (target) target.scrollIntoView();
      return;
    }
    if (place === undefined) {
      section.replaceChildren(make("h2", {}, "There is no such trial"), make("a", { href: "#trials" }, "← all trials"));
      return;
    }
    const [number, row] = place, pair = study.pairs[number], found = await block(number);
    if (location.hash !== `#trial-${id}`) return;
    const trial = found.trials[row], [bar, same] = links(number, row, found);
    const title = make("h2", { tabindex: "-1" }, `${trial.estimator}, ${pair.condition}, seed ${pair.seed}`);
    section.replaceChildren(bar, title, facts(trial, id), same,
      make("div", { class: "figures" }, ...figures(trial, found.truth)), table(trial));
    window.scrollTo(0, 0);
    title.focus({ preventScroll: true });
  }

  addEventListener("hashchange", show);
  show();
})();
