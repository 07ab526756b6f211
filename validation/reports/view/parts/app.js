// The page: its state, its controls and what they show.

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const [width, height] = data.size_px;
const stage = $("stage"), frame = $("frame"), cross = $("cross"), divider = $("divider");
stage.width = width;
stage.height = height;
frame.style.setProperty("--aspect", width / height);

const MODES = { refocus: "Refocus", compare: "Compare", depth: "Depth", channels: "Channels", mosaic: "Mosaic", solid: "3D" };
const MOST_ZOOM = 64, MOST_TURN = 1.3, TAP_PX = 6;
const TURNED = { turn: 0.08, tilt: 0.03, zoom: 0.9 };  // of the surface at first: enough to see that it is one
const KEPT_PIXELS = 6e7;  // of decoded pictures
const state = {
  mode: "", aperture: 0, wanted: 1, split: 0.5, left: "captured", right: "all-in-focus", map: "", channel: "", shown: "tinted",
  point: [width >> 1, height >> 1], view: { zoom: 1, x: 0.5, y: 0.5 }, turned: { ...TURNED }, least: 0.05,
};
const numbers = {};  // decoded: depth, true_depth (dioptres), confidence, raw

// --- painting --------------------------------------------------------------------------------------

const gl = stage.getContext("webgl2", { preserveDrawingBuffer: true, alpha: false });
let painter = null, solid = null;
function prepare() {
  painter = gl ? glPainter(gl) : flatPainter(stage.getContext("2d"));
  solid = gl ? solidPainter(gl, painter) : null;
}
function sorry(text) {
  $("sorry").textContent = text;
  $("sorry").hidden = false;
}
prepare();
if (!gl) sorry("This browser has no WebGL2: pictures are shown without it, and the 3D view is not available.");
stage.addEventListener("webglcontextlost", (event) => event.preventDefault());
stage.addEventListener("webglcontextrestored", () => { prepare(); update(); });

const texts = new Map([...data.pictures.map((p) => [p.id, p.data]), ...data.channels.map((p) => [`channel ${p.id}`, p.data])]);
data.stack.forEach(({ slices }, a) => slices.forEach((slice, s) => texts.set(`slice ${a} ${s}`, slice.data)));
const picture = remembered(Math.max(8, Math.floor(KEPT_PIXELS / (width * height))), (key) => decodePicture(texts.get(key)));
const mapPicture = remembered(6, (key) => {
  const of = MAPS[key];
  return colouredMap(of.values(), width, height, of.scale());
});
const rawPicture = remembered(3, (key) => mosaicPicture(numbers.raw, width, height, data.mosaic, key));

function outside() {
  const parts = getComputedStyle(frame).backgroundColor.match(/[\d.]+/g) ?? [0, 0, 0];
  return parts.slice(0, 3).map((part) => part / 255);
}

function mosaicShare() {
  const cells = data.mosaic.pattern.flat(), alone = cells.filter((name) => name === state.shown).length;
  return { period: data.mosaic.pattern.length, share: (alone || cells.length) / cells.length };
}

let turn = 0;  // of the latest painting: earlier ones that are decoded later are dropped
async function paint() {
  const mine = ++turn, wanted = sources();
  const [left, right] = await Promise.all(wanted.map((source) => source.get()));
  if (mine !== turn) return;
  if (state.mode === "solid") paintSolid(left);
  else painter.paint({ left, right: right ?? left, split: right ? state.split : 2, view: state.view, outside: outside(),
    mosaic: state.mode === "mosaic" ? mosaicShare() : null });
  stage.dataset.shown = wanted.map((source) => source.name).join(" | ");
  stage.setAttribute("aria-label", `${MODES[state.mode]}: ${wanted.map((source) => source.label).join(" beside ")}`);
  wanted.forEach((source, i) => { $(i ? "tag-right" : "tag-left").textContent = source.label; });
  $("tag-left").hidden = state.mode === "refocus";
  $("tag-right").hidden = wanted.length < 2;
  place();
}

const labels = Object.fromEntries(data.pictures.map((p) => [p.id, p.label]));
function source(id) {
  if (id === "refocused") return slice();
  if (MAPS[id]) return { name: id, label: MAPS[id].label, get: () => mapPicture(id) };
  return { name: id, label: labels[id], get: () => picture(id) };
}
function slice() {
  const s = current(), { f_number: number, slices } = data.stack[state.aperture];
  return { name: `slice ${state.aperture} ${s}`, label: `f/${number}, focus ${centimetres(slices[s].depth_m)}`,
    get: () => picture(`slice ${state.aperture} ${s}`) };
}
function sources() {
  if (state.mode === "refocus") return [slice()];
  if (state.mode === "compare") return [source(state.left), source(state.right)];
  if (state.mode === "depth") return [source(state.map)];
  if (state.mode === "channels") {
    return [{ name: state.channel, label: state.channel, get: () => picture(`channel ${state.channel}`) }];
  }
  if (state.mode === "mosaic") return [{ name: state.shown, label: SHOWN[state.shown] ?? state.shown, get: () => rawPicture(state.shown) }];
  return [source($("solid-picture").value)];
}

// --- focal stack -----------------------------------------------------------------------------------

// The slice of the current aperture that is closest in dioptres to the wanted focus distance.
function current() {
  const far = (slice) => Math.abs(1 / slice.depth_m - 1 / state.wanted), { slices } = data.stack[state.aperture];
  return slices.reduce((best, slice, i) => (far(slice) < far(slices[best]) ? i : best), 0);
}
function focusAt([x, y]) {
  const near = numbers.depth[y * width + x];
  if (!(near > 0)) return;
  state.wanted = 1 / near;
  update();
}
function focusStep(step) {
  const { slices } = data.stack[state.aperture];
  state.wanted = slices[Math.min(Math.max(current() + step, 0), slices.length - 1)].depth_m;
  update();
}
function apertureStep(step) {
  state.aperture = Math.min(Math.max(state.aperture + step, 0), data.stack.length - 1);
  update();
}
function showFocus() {
  const { f_number: number, slices } = data.stack[state.aperture], s = current();
  const said = centimetres(slices[s].depth_m);
  Object.assign($("focus"), { max: slices.length - 1, value: s });
  $("focus").setAttribute("aria-valuetext", said);
  $("focus-value").textContent = said;
  $("focus-near").textContent = `near, ${centimetres(slices[0].depth_m)}`;
  $("focus-far").textContent = `far, ${centimetres(slices.at(-1).depth_m)}`;
  $("aperture").value = state.aperture;
  $("aperture").setAttribute("aria-valuetext", `f/${number}`);
  $("aperture-value").textContent = `f/${number}`;
  $("slice").textContent = `Picture ${s + 1} of ${slices.length} at f/${number}.`;
}

// --- maps and values -------------------------------------------------------------------------------

const derived = remembered(3, (name) => ({
  sd: () => numbers.depth.map((near, i) => sdMetres(i) * 100),
  error: () => numbers.depth.map((near, i) => 100 / near - 100 / numbers.true_depth[i]),
}[name]()));
const sdLevels = (i) => data.sd.at_half * Math.sqrt(1 / numbers.confidence[i] - 1);
const sdMetres = (i) => sdLevels(i) * data.sd.dioptres_per_level / numbers.depth[i] ** 2;
const range = remembered(6, (key) => {
  const both = ["depth", "true_depth"].filter((name) => numbers[name]);
  if (key !== "depth") return quantile(key === "sd" ? derived("sd") : derived("error").map(Math.abs), 0.95);
  return { low: Math.min(...both.map((name) => quantile(numbers[name], 0.005))),
    high: Math.max(...both.map((name) => quantile(numbers[name], 0.995))) };
});
const asDepth = () => ({ ...range("depth"), colours: VIRIDIS, label: (near) => centimetres(1 / near) });
const MAPS = {};
function listMaps() {
  const { depth, true_depth: truth, confidence } = numbers;
  if (depth) MAPS.depth = { label: "Estimated depth", values: () => depth, scale: asDepth,
    hint: "Colours are even in dioptres, in which blur is linear." };
  if (truth) MAPS.true_depth = { label: "True depth", values: () => truth, scale: asDepth,
    hint: "Colours are even in dioptres. Grey: nothing is there." };
  if (depth && confidence) {
    MAPS.confidence = { label: "Confidence", values: () => confidence,
      scale: () => ({ low: 0, high: 1, colours: VIRIDIS, label: (v) => v.toFixed(2) }),
      hint: "1 is certain; 0.5 is a standard deviation of one blur level." };
    MAPS.sd = { label: "Standard deviation of depth", values: () => derived("sd"),
      scale: () => ({ low: 0, high: range("sd"), colours: VIRIDIS, label: (v) => `${digits(v, range("sd"))} cm` }),
      hint: "What the confidence says, in cm at the estimated depth; the scale ends at the 95th percentile." };
  }
  if (depth && truth) MAPS.error = { label: "Error of depth", values: () => derived("error"),
    scale: () => ({ low: -range("error"), high: range("error"), colours: TWO_SIDED,
      label: (v) => `${digits(v, range("error"))} cm` }),
    hint: "Estimated minus true depth; the scale ends at the 95th percentile. Grey: nothing is there." };
}
function showMap() {
  const map = MAPS[state.map], scale = map.scale();
  const stops = Array.from({ length: 11 }, (_, i) => `rgb(${between(scale.colours, i / 10).join(" ")})`);
  $("bar").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  $("bar-ticks").replaceChildren(...ticks(scale).map((text) => Object.assign(document.createElement("span"), { textContent: text })));
  $("map-hint").textContent = map.hint;
}

function probed([x, y]) {
  const i = y * width + x, said = [["Pixel", `${x}, ${y}`]], near = numbers.depth?.[i];
  if (near > 0) {
    const sd = sdMetres(i) * 100;
    said.push(["Depth", `${(100 / near).toFixed(2)} ± ${digits(sd, sd)} cm`], ["Confidence", numbers.confidence[i].toFixed(3)]);
  }
  if (numbers.true_depth) said.push(["True depth", numbers.true_depth[i] > 0 ? `${(100 / numbers.true_depth[i]).toFixed(2)} cm` : "nothing there"]);
  if (numbers.raw) {
    const { pattern, black_dn: black, e_per_dn: each, full_dn: full } = data.mosaic, dn = numbers.raw[i];
    const electrons = `${((dn - black) * each).toFixed(0)} e⁻`;
    said.push([`Raw ${channelAt(pattern, x, y)}`, `${dn} DN, ${electrons}${dn >= full ? ", saturated" : ""}`]);
  }
  return said;
}
function showProbe() {
  $("probe").replaceChildren(...probed(state.point).map(([name, text]) => {
    const part = document.createElement("span"), value = document.createElement("b");
    value.textContent = text;
    part.append(`${name} `, value);
    return part;
  }));
  place();
  if (state.mode === "mosaic") showLoupe();
}

const SHOWN = { tinted: "Raw mosaic, in its colours", grey: "Raw mosaic, grey" };
const CELLS = 9;
function showLoupe() {
  const context = $("loupe").getContext("2d"), size = $("loupe").width / CELLS, [px, py] = state.point;
  const seen = rawPicture(state.shown);
  context.imageSmoothingEnabled = false;
  context.fillStyle = getComputedStyle(frame).backgroundColor;
  context.fillRect(0, 0, size * CELLS, size * CELLS);
  const left = px - (CELLS >> 1), top = py - (CELLS >> 1);
  context.drawImage(seen, left, top, CELLS, CELLS, 0, 0, size * CELLS, size * CELLS);
  context.font = `600 ${size * 0.27}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.lineWidth = 4;
  context.strokeStyle = "#000";
  context.fillStyle = "#fff";
  for (let j = 0; j < CELLS; j++) for (let i = 0; i < CELLS; i++) {
    const x = left + i, y = top + j;
    if (x < 0 || y < 0 || x >= width || y >= height) continue;
    const lines = [channelAt(data.mosaic.pattern, x, y), numbers.raw[y * width + x]];
    lines.forEach((text, row) => {
      const at = [text, (i + 0.5) * size, (j + 0.42 + 0.34 * row) * size];
      context.strokeText(...at);
      context.fillText(...at);
    });
  }
  context.strokeStyle = "#fff";
  context.strokeRect((px - left) * size + 2, (py - top) * size + 2, size - 4, size - 4);
}

// --- places on the stage ---------------------------------------------------------------------------

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
function placeAt(event) {  // of an event, in the picture, 0..1
  const box = stage.getBoundingClientRect(), { zoom, x, y } = state.view;
  return [x + ((event.clientX - box.left) / box.width - 0.5) / zoom, y + ((event.clientY - box.top) / box.height - 0.5) / zoom];
}
const pixelAt = ([x, y]) => [clamp(Math.floor(x * width), 0, width - 1), clamp(Math.floor(y * height), 0, height - 1)];
const across = (x, centre) => (x - centre) * state.view.zoom + 0.5;
function place() {
  const [x, y] = [across((state.point[0] + 0.5) / width, state.view.x), across((state.point[1] + 0.5) / height, state.view.y)];
  cross.hidden = state.mode === "solid" || x < 0 || x > 1 || y < 0 || y > 1;
  cross.style.left = `${x * 100}%`;
  cross.style.top = `${y * 100}%`;
  const at = across(state.split, state.view.x);
  divider.hidden = state.mode !== "compare" || at < 0 || at > 1;
  divider.style.left = `${at * 100}%`;
  stage.classList.toggle("captive", state.mode === "solid" || state.view.zoom > 1);
}
function magnify(factor, [x, y] = [state.view.x, state.view.y]) {
  if (state.mode === "solid") state.turned.zoom = clamp(state.turned.zoom * factor, 0.3, 8);
  else {
    const { view } = state, before = view.zoom;
    view.zoom = clamp(before * factor, 1, MOST_ZOOM);
    view.x = x + (view.x - x) * before / view.zoom;
    view.y = y + (view.y - y) * before / view.zoom;
    keepInside();
  }
  paint();
}
function keepInside() {
  const { view } = state, half = 0.5 / view.zoom;
  view.x = clamp(view.x, half, 1 - half);
  view.y = clamp(view.y, half, 1 - half);
}
function whole() {
  state.view = { zoom: 1, x: 0.5, y: 0.5 };
  state.turned = { ...TURNED };
  paint();
}
function move(dx, dy) {  // in stage widths and heights
  if (state.mode === "solid") {
    state.turned.turn = clamp(state.turned.turn - dx * 1.5, -MOST_TURN, MOST_TURN);
    state.turned.tilt = clamp(state.turned.tilt + dy * 1.5, -MOST_TURN, MOST_TURN);
  } else {
    state.view.x -= dx / state.view.zoom;
    state.view.y -= dy / state.view.zoom;
    keepInside();
  }
  paint();
}
function mark(point) {
  state.point = [clamp(point[0], 0, width - 1), clamp(point[1], 0, height - 1)];
  showProbe();
}

// --- surface ---------------------------------------------------------------------------------------

let meshOf = "";
function paintSolid(texture) {
  const of = $("solid-depth").value, estimated = of === "depth", key = `${of} ${estimated ? state.least : ""}`;
  if (meshOf !== key || !solid.loaded()) {
    solid.load(heightField({
      dioptres: numbers[of], confidence: estimated ? numbers.confidence : null, least: state.least, width, height,
      intrinsic: data.intrinsic_px, distortion: data.distortion_per_px, jump: data.jump_share,
    }));
    meshOf = key;
  }
  const matrix = projection(state.turned, solid.loaded().middle, data.intrinsic_px, width, height);
  solid.paint(texture, matrix, outside());
  stage.dataset.triangles = solid.loaded().triangles.length / 3;
}

// --- controls --------------------------------------------------------------------------------------

function update() {
  if (state.mode === "refocus") showFocus();
  if (state.mode === "depth") showMap();
  $("split-value").textContent = `${Math.round(state.split * 100)} %`;
  $("split").value = Math.round(state.split * 100);
  $("least-value").textContent = state.least.toFixed(2);
  $("least-row").hidden = $("solid-depth").value !== "depth";
  showProbe();
  return paint();
}
function enter(mode) {
  if (!mode || $("modes").querySelector(`[data-mode="${mode}"]`).disabled) return;
  state.mode = mode;
  for (const button of $("modes").children) button.setAttribute("aria-pressed", button.dataset.mode === mode);
  for (const section of document.querySelectorAll("[data-panel]")) section.hidden = section.dataset.panel !== mode;
  update();
}
function fill(select, options, chosen) {
  select.replaceChildren(...options.map(([value, text]) => new Option(text, value, false, value === chosen)));
}
function listen(id, type, act) {
  $(id).addEventListener(type, (event) => { act(event.target.value); update(); });
}
function pressed(group, value) {
  for (const button of group.children) button.setAttribute("aria-pressed", button.value === value);
}

function controls() {
  const kinds = data.pictures.map((p) => [p.id, p.label]), maps = Object.entries(MAPS).map(([id, { label }]) => [id, label]);
  const both = [...kinds, ...(data.stack.length ? [["refocused", "Refocused, as chosen"]] : []), ...maps];
  const has = (id) => both.some(([known]) => known === id);
  state.right = ["all-in-focus", "truth"].find(has) ?? both.at(-1)[0];
  fill($("left"), both, state.left);
  fill($("right"), both, state.right);
  fill($("map"), maps, state.map = maps[0]?.[0] ?? "");
  const depths = maps.filter(([id]) => id === "depth" || id === "true_depth");
  fill($("solid-depth"), depths, depths[0]?.[0]);
  fill($("solid-picture"), kinds, state.right === "depth" ? "captured" : state.right);
  if (data.mosaic) {
    const { pattern, black_dn: black, e_per_dn: each } = data.mosaic;
    for (const name of new Set(pattern.flat())) SHOWN[name] = `Raw pixels of ${name} alone`;
    fill($("shown"), Object.entries(SHOWN), state.shown);
    $("mosaic-hint").textContent = `Black level ${black} DN, ${each.toFixed(2)} e⁻ per DN. Magenta: saturated.`;
  }
  $("channel").replaceChildren(...data.channels.map(({ id }) => {
    const button = Object.assign(document.createElement("button"), { type: "button", value: id, textContent: id });
    button.addEventListener("click", () => { state.channel = id; pressed($("channel"), id); update(); });
    return button;
  }));
  pressed($("channel"), state.channel = data.channels[0]?.id);
  if (data.stack.length) {
    $("aperture").max = data.stack.length - 1;
    $("aperture-open").textContent = `f/${data.stack[0].f_number}`;
    $("aperture-closed").textContent = `f/${data.stack.at(-1).f_number}`;
    state.wanted = data.stack[0].slices.at(-1).depth_m;
  }
  const usable = { refocus: data.stack.length, compare: both.length > 1, depth: maps.length, channels: data.channels.length,
    mosaic: data.mosaic, solid: solid && depths.length };
  for (const button of $("modes").children) {
    button.disabled = !usable[button.dataset.mode];
    button.addEventListener("click", () => enter(button.dataset.mode));
  }
  listen("focus", "input", (value) => { state.wanted = data.stack[state.aperture].slices[value].depth_m; });
  listen("aperture", "input", (value) => { state.aperture = Number(value); });
  listen("split", "input", (value) => { state.split = value / 100; });
  listen("least", "input", (value) => { state.least = Number(value); });
  for (const name of ["left", "right", "map", "shown"]) listen(name, "input", (value) => { state[name] = value; });
  for (const name of ["solid-depth", "solid-picture"]) listen(name, "input", () => {});
  $("in").addEventListener("click", () => magnify(1.5));
  $("out").addEventListener("click", () => magnify(1 / 1.5));
  $("reset").addEventListener("click", whole);
  return Object.keys(usable).find((mode) => usable[mode]);
}

function pointers() {
  const down = new Map();  // pointers on the stage
  let tapped = false, start = null;
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    down.set(event.pointerId, [event.clientX, event.clientY]);
    tapped = down.size === 1;
    start = [event.clientX, event.clientY];
  });
  stage.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse" && !down.size && state.mode !== "solid") mark(pixelAt(placeAt(event)));
    const before = down.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], box = stage.getBoundingClientRect();
    if (Math.hypot(now[0] - start[0], now[1] - start[1]) > TAP_PX) tapped = false;
    down.set(event.pointerId, now);
    if (down.size === 2) {
      const other = [...down].find(([id]) => id !== event.pointerId)[1], span = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      const middle = { clientX: (now[0] + other[0]) / 2, clientY: (now[1] + other[1]) / 2 };
      if (span(before) > 0) magnify(span(now) / span(before), placeAt(middle));
    } else if (!tapped && (state.mode === "solid" || state.view.zoom > 1)) {
      move((now[0] - before[0]) / box.width, (now[1] - before[1]) / box.height);
    }
  });
  const up = (event) => {
    const was = down.delete(event.pointerId);
    if (event.type !== "pointerup" || !was || !tapped || state.mode === "solid") return;
    mark(pixelAt(placeAt(event)));
    if (state.mode === "refocus") focusAt(state.point);
  };
  for (const type of ["pointerup", "pointercancel"]) stage.addEventListener(type, up);
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    magnify(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.002)), placeAt(event));
  }, { passive: false });
  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    state.split = clamp(placeAt(event)[0], 0, 1);
    update();
  });
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
function keyboard(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  const steps = { "[": () => focusStep(-1), "]": () => focusStep(1), ",": () => apertureStep(-1), ".": () => apertureStep(1) };
  const acts = { "+": () => magnify(1.25), "=": () => magnify(1.25), "-": () => magnify(0.8), 0: whole };
  const views = Object.keys(MODES);
  if (event.key in steps && data.stack.length) {
    enter("refocus");
    steps[event.key]();
  } else if (event.key in acts) acts[event.key]();
  else if (views[event.key - 1]) enter(views[event.key - 1]);
  else if (event.target === stage && event.key in ARROWS) {
    const [dx, dy] = ARROWS[event.key], far = event.shiftKey ? 10 : 1;
    if (state.mode === "solid") move(dx * far / 60, dy * far / 60);
    else mark([state.point[0] + dx * far, state.point[1] + dy * far]);
  } else if (event.target === stage && event.key === "Enter" && state.mode === "refocus") focusAt(state.point);
  else return;
  event.preventDefault();
}

async function begin() {
  const { maps, mosaic } = data;
  const jobs = Object.entries(maps).map(async ([name, map]) => { numbers[name] = await decodeMap(map, width, height); });
  if (mosaic) jobs.push(decodeNumbers(mosaic.data, width, height).then((found) => { numbers.raw = found; }));
  await Promise.all(jobs);
  listMaps();
  const first = controls();
  pointers();
  document.addEventListener("keydown", keyboard);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", update);
  enter(first);
  document.body.dataset.ready = "yes";
}
begin().catch((error) => sorry(`This page cannot be shown in this browser (${error.message}). A recent Chrome, Firefox or Safari can.`));
