// The player: poses of a moment, interpolated between the kept ones, several backends over each other.

const DATA = JSON.parse(document.getElementById("data").textContent);
const STATES = ["waits", "tracks the ball", "motion started", "motion updated", "motion kept"];
const EVENT_NAMES = { throw: "throw", onset: "start", touch: "touch", ball_landed: "landed" };
const VIEWS = {
  free: { yaw: -64, pitch: 13, distance: 4.4, target: [1.0, 0, 1.18] },
  side: { yaw: -90, pitch: 3, distance: 4.6, target: [1.25, 0, 1.1] },
  back: { yaw: -176, pitch: 9, distance: 4.2, target: [0.8, 0, 1.1] },
  hand: { yaw: -58, pitch: 12, distance: 1.7, target: null },
};
const VIEW_ANGLE = 0.62; // [rad] vertical
const byId = (id) => document.getElementById(id);

function unpack({ step, columns, data }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const whole = new Int16Array(bytes.buffer);
  const numbers = Float32Array.from(whole, (value) => value * step);
  return { numbers, columns, at: (row) => numbers.subarray(row * columns, (row + 1) * columns) };
}

// Rows before and after a time, and how far between them it is.
function between(times, time) {
  let low = 0, high = times.length - 1;
  if (time <= times[0]) return [0, 0, 0];
  if (time >= times[high]) return [high, high, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  return [low, high, (time - times[low]) / (times[high] - times[low])];
}

function mixed(track, [low, high, share]) {
  const a = track.at(low), b = track.at(high);
  return Array.from(a, (value, i) => value + share * (b[i] - value));
}

const offsets = (counts) => { let sum = 0; return counts.map((count) => { const start = sum; sum += count; return start; }); };

class TrialMotion {
  constructor(trial) {
    this.trial = trial;
    for (const part of ["robot", "ball", "markers", "hand", "plans"]) {
      if (!trial[part]) continue;
      this[part] = {};
      for (const [key, value] of Object.entries(trial[part])) this[part][key] = value.data === undefined ? value : unpack(value);
      this[part].times = this[part].time.numbers;
      if (this[part].count) this[part].offset = offsets(this[part].count);
    }
    this.event = Object.fromEntries(trial.events.map(([time, name]) => [name, time]).reverse());
  }

  links(time) {
    if (!this.robot || !DATA.robot) return [];
    const when = between(this.robot.times, time);
    const trunk = Mat.place(mixed(this.robot.turn, when), mixed(this.robot.position, when));
    const angles = mixed(this.robot.angle, when), poses = [];
    for (const link of DATA.robot.links) {
      if (link.parent < 0) { poses.push(trunk); continue; }
      let pose = Mat.multiply(poses[link.parent], Mat.place(link.turn, link.at));
      if (link.angle >= 0) {
        const move = angles[link.angle];
        pose = Mat.multiply(pose, link.slides ? Mat.place([1, 0, 0, 0], link.axis.map((part) => part * move)) : Mat.turn(link.axis, move));
      }
      poses.push(pose);
    }
    return poses;
  }

  ballAt(time) {
    if (!this.ball || time < this.ball.times[0] - 0.02 || time > this.ball.times[this.ball.times.length - 1] + 0.02) return null;
    return mixed(this.ball.position, between(this.ball.times, time));
  }

  handAt(time) { return this.hand ? mixed(this.hand.position, between(this.hand.times, time)) : null; }

  markersAt(time) {
    if (!this.markers) return [];
    const [row] = between(this.markers.times, time);
    return Array.from({ length: this.markers.count[row] }, (_, i) => Array.from(this.markers.position.at(this.markers.offset[row] + i)));
  }

  planAt(time) {
    if (!this.plans || time < this.plans.times[0]) return null;
    const [row] = between(this.plans.times, time + 1e-4), plans = this.plans;
    return {
      state: STATES[plans.state[row]] || "",
      due: plans.due.at(row)[0],
      target: plans.started[row] ? Array.from(plans.target.at(row)) : null,
      path: Array.from({ length: plans.count[row] }, (_, i) => Array.from(plans.path.at(plans.offset[row] + i))),
    };
  }

  // The way of a track up to a time, as pieces.
  way(track, key, from, time) {
    if (!track) return [];
    const out = [];
    let last = null;
    for (let i = 0; i < track.times.length && track.times[i] <= time; i++) {
      if (track.times[i] < from) continue;
      const point = track[key].at(i);
      if (last) out.push(...last, ...point);
      last = point;
    }
    if (last) out.push(...last, ...mixed(track[key], between(track.times, time)));
    return out;
  }
}

function dotted(points) {
  const out = [], pieces = 2;
  for (let i = 0; i + 1 < points.length; i++)
    for (let k = 0; k < pieces; k++) {
      const at = (share) => points[i].map((value, axis) => value + share * (points[i + 1][axis] - value));
      out.push(...at(k / pieces), ...at((k + 0.45) / pieces));
    }
  return out;
}

const color = (hex) => [1, 3, 5].map((start) => parseInt(hex.slice(start, start + 2), 16) / 255);
const blend = (a, b, share) => a.map((value, i) => value + share * (b[i] - value));

class Player {
  constructor() {
    this.trials = DATA.trials;
    this.motions = new Map();
    this.hidden = new Set();
    this.time = 0;
    this.playing = false;
    this.camera = { ...VIEWS.free, view: "free" };
    this.canvas = byId("canvas");
    if (!this.trials.length) return this.refuse("The logs of these trials are not here, so there is nothing to replay.");
    try {
      this.scene = new Scene(this.canvas);
    } catch (problem) {
      return this.refuse("The replay needs WebGL 2, which this browser does not offer.");
    }
    this.readTheme();
    this.fill();
    this.listen();
    this.show(this.firstChoice());
  }

  refuse(reason) {
    byId("empty").textContent = reason;
    byId("empty").hidden = false;
    for (const element of byId("player").querySelectorAll("button, select, input")) element.disabled = true;
  }

  // The first ball that most backends hit with the last method: it shows most.
  firstChoice() {
    const last = this.trials[this.trials.length - 1].method, hits = {};
    for (const trial of this.trials) if (trial.method === last && trial.success) hits[trial.number] = (hits[trial.number] || 0) + 1;
    const best = Math.max(0, ...Object.values(hits));
    return this.trials.find((trial) => trial.method === last && (hits[trial.number] || 0) === best) || this.trials[0];
  }

  motion(trial) {
    if (!this.motions.has(trial.id)) this.motions.set(trial.id, new TrialMotion(trial));
    return this.motions.get(trial.id);
  }

  fill() {
    const unique = (key) => [...new Set(this.trials.map((trial) => trial[key]))];
    for (const ball of unique("number").sort((a, b) => a - b)) byId("ball").add(new Option(ball, ball));
    for (const method of unique("method")) byId("method").add(new Option(method, method));
  }

  readTheme() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => { const text = style.getPropertyValue(name).trim(); return color(text.length === 4 ? "#" + [...text.slice(1)].map((c) => c + c).join("") : text); };
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    this.theme = {
      sky: read("--sky"), ground: read("--ground"), grid: read("--grid"), shadow: parseFloat(style.getPropertyValue("--shadow")),
      box: dark ? [0.36, 0.33, 0.29] : [0.80, 0.76, 0.69], ball: [0.93, 0.33, 0.2], target: dark ? [0.27, 0.85, 0.52] : [0.05, 0.55, 0.28], lighten: dark ? 0.28 : 0,
    };
  }

  tint(backend) { return blend(color(DATA.colors[backend]), [1, 1, 1], this.theme.lighten); }

  get group() { return this.trials.filter((trial) => trial.method === this.chosen.method && trial.number === this.chosen.number); }

  show(trial, keepTime = false) {
    this.chosen = trial;
    this.hidden.delete(trial.backend);
    byId("ball").value = trial.number;
    byId("method").value = trial.method;
    this.duration = Math.max(...this.group.map((one) => one.duration));
    byId("time").max = this.duration;
    const events = this.motion(trial).event;
    // The moment before the end of the flight, unless the user looks at one already.
    if (!keepTime) this.time = Math.max(0, (events.touch ?? events.ball_landed ?? this.duration) - 0.02);
    this.time = Math.min(this.time, this.duration);
    this.drawEngines();
    this.drawTicks();
    for (const element of document.querySelectorAll("[data-trial], .map [data-show]"))
      element.classList.toggle("chosen", (element.dataset.trial || element.dataset.show) === trial.id);
    this.update();
  }

  drawEngines() {
    const box = byId("engines");
    for (const card of box.querySelectorAll(".engine")) card.remove();
    this.readouts = new Map();
    for (const trial of this.group) {
      const card = document.createElement("div");
      card.className = "engine" + (trial === this.chosen ? " focus" : "");
      card.style.setProperty("--engine", DATA.colors[trial.backend]);
      const head = document.createElement("div");
      head.className = "head";
      const tick = Object.assign(document.createElement("input"), { type: "checkbox", checked: !this.hidden.has(trial.backend) });
      tick.setAttribute("aria-label", `Show ${trial.backend}`);
      tick.addEventListener("change", () => { this.hidden[tick.checked ? "delete" : "add"](trial.backend); this.update(); });
      const swatch = Object.assign(document.createElement("i"), { className: "swatch" });
      swatch.style.cssText = DATA.swatches[trial.backend];
      const name = Object.assign(document.createElement("b"), { textContent: trial.backend });
      head.append(tick, swatch, name);
      if (this.group.length > 1) {
        const front = Object.assign(document.createElement("button"), { type: "button", textContent: "in front" });
        front.setAttribute("aria-pressed", trial === this.chosen);
        front.addEventListener("click", () => { this.show(trial, true); byId("engines").querySelectorAll("[aria-pressed=true]")[0]?.focus(); });
        head.append(front);
      }
      const result = Object.assign(document.createElement("p"), { textContent: trial.outcome });
      const readout = document.createElement("p");
      card.append(head, result, readout);
      box.append(card);
      this.readouts.set(trial, readout);
      const hit = this.motion(trial).event.touch;
      if (trial.success && hit !== undefined) result.textContent += ` at ${hit.toFixed(3)} s`;
    }
    byId("hud").replaceChildren(
      Object.assign(document.createElement("b"), { textContent: `Ball ${this.chosen.number}` }),
      Object.assign(document.createElement("span"), { textContent: ` · ${this.chosen.method}` }),
    );
  }

  drawTicks() {
    const ticks = [];
    let before = -1;
    for (const [time, name] of this.chosen.events) {
      if (!EVENT_NAMES[name]) continue;
      const share = time / this.duration, tick = document.createElement("span");
      tick.style.left = `${100 * share}%`;
      tick.textContent = share - before > 0.13 ? EVENT_NAMES[name] : "\u00a0";
      before = share;
      ticks.push(tick);
    }
    byId("ticks").replaceChildren(...ticks);
  }

  listen() {
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("play", "click", () => this.toggle());
    on("time", "input", () => { this.pause(); this.seek(parseFloat(byId("time").value)); });
    const choose = (ball, method) => {
      const same = this.trials.filter((trial) => trial.number === ball && trial.method === method);
      const next = same.find((trial) => trial.backend === this.chosen.backend) || same[0];
      if (next) this.show(next);
    };
    on("ball", "change", () => choose(Number(byId("ball").value), this.chosen.method));
    on("method", "change", () => choose(this.chosen.number, byId("method").value));
    const step = (by) => {
      const select = byId("ball"), index = (select.selectedIndex + by + select.length) % select.length;
      choose(Number(select.options[index].value), this.chosen.method);
    };
    on("previous", "click", () => step(-1));
    on("next", "click", () => step(1));
    for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => this.view(button.dataset.view));
    for (const button of document.querySelectorAll("[data-zoom]")) button.addEventListener("click", () => this.zoom(parseFloat(button.dataset.zoom)));
    for (const button of document.querySelectorAll("[data-show]"))
      button.addEventListener("click", () => {
        const trial = this.trials.find((one) => one.id === button.dataset.show);
        if (!trial) return;
        this.pause();
        this.show(trial);
        byId("replay").scrollIntoView();
        this.canvas.focus({ preventScroll: true });
      });
    byId("player").addEventListener("keydown", (event) => this.key(event));
    this.listenToPointers();
    new ResizeObserver(() => this.request()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.readTheme(); this.request(); });
  }

  listenToPointers() {
    const down = new Map();
    const spread = () => { const [a, b] = [...down.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
    this.canvas.addEventListener("pointerdown", (event) => { down.set(event.pointerId, { x: event.clientX, y: event.clientY }); this.canvas.setPointerCapture(event.pointerId); });
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, (event) => down.delete(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => {
      const last = down.get(event.pointerId);
      if (!last) return;
      const before = down.size === 2 ? spread() : 0;
      const dx = event.clientX - last.x, dy = event.clientY - last.y;
      last.x = event.clientX; last.y = event.clientY;
      if (down.size === 2) this.zoom(before / Math.max(spread(), 1)); else this.turn(-0.4 * dx, 0.3 * dy);
    });
    this.canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      this.zoom(Math.exp(0.004 * event.deltaY));
    }, { passive: false });
  }

  key(event) {
    const own = event.target === this.canvas, slider = event.target === byId("time");
    if (!own && !slider || event.ctrlKey || event.metaKey || event.altKey) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    if (event.key === " ") this.toggle();
    else if (event.key === "v" || event.key === "V") { const names = Object.keys(VIEWS); this.view(names[(names.indexOf(this.camera.view) + 1) % names.length]); }
    else if (event.key === "+" || event.key === "-") this.zoom(event.key === "+" ? 0.8 : 1.25);
    else if (own && event.shiftKey && arrows[event.key]) this.turn(6 * arrows[event.key][0], 4 * arrows[event.key][1]);
    else if (event.key === "ArrowLeft" || event.key === "ArrowRight") { this.pause(); this.seek(this.time + arrows[event.key][0] / 120); }
    else if (event.key === "Home" || event.key === "End") { this.pause(); this.seek(event.key === "Home" ? 0 : this.duration); }
    else return;
    event.preventDefault();
  }

  turn(yaw, pitch) {
    this.camera.yaw += yaw;
    this.camera.pitch = Math.min(85, Math.max(1, this.camera.pitch + pitch));
    this.request();
  }

  zoom(factor) { this.camera.distance = Math.min(9, Math.max(0.6, this.camera.distance * factor)); this.request(); }

  view(name) {
    this.camera = { ...VIEWS[name], view: name };
    for (const button of document.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", button.dataset.view === name);
    this.request();
  }

  toggle() { if (this.playing) this.pause(); else this.play(); }

  play() {
    if (this.time >= this.duration - 1e-3) this.time = 0;
    this.playing = true;
    this.last = performance.now();
    this.showState();
    this.request();
  }

  pause() { this.playing = false; this.showState(); }

  showState() {
    byId("play").setAttribute("aria-label", this.playing ? "Pause" : "Play");
    byId("play-icon").setAttribute("d", this.playing ? "M6 4h4v16H6zM14 4h4v16h-4z" : "M7 4l13 8-13 8z");
  }

  seek(time) { this.time = Math.min(this.duration, Math.max(0, time)); this.update(); }

  update() {
    byId("time").value = this.time;
    byId("time").setAttribute("aria-valuetext", `${this.time.toFixed(3)} seconds`);
    byId("clock").textContent = `${this.time.toFixed(3)} s`;
    for (const [trial, readout] of this.readouts) {
      const motion = this.motion(trial), plan = motion.planAt(this.time), hand = motion.handAt(this.time);
      const parts = plan ? [`At ${this.time.toFixed(3)} s: ${plan.state}`] : [];
      // On its way; how near the hand came in the end is in the list of trials.
      if (plan && plan.target && hand && this.time < plan.due) {
        const way = Math.round(1e3 * Math.hypot(...hand.map((value, i) => value - plan.target[i])));
        parts.push(`hand has ${way} mm and ${Math.round(1e3 * (plan.due - this.time))} ms to go`);
      }
      readout.textContent = parts.join("; ") || "\u00a0";
    }
    const shown = this.group.filter((trial) => !this.hidden.has(trial.backend)).map((trial) => (/[^\w./-]/.test(trial.path) ? `'${trial.path}'` : trial.path));
    byId("command").textContent = shown.length ? `imolo view ${shown.join(" ")}` : "";
    this.request();
  }

  request() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame((now) => { this.pending = false; this.frame(now); });
  }

  frame(now) {
    if (this.playing) {
      this.time += Math.max(0, now - this.last) * 1e-3 * parseFloat(byId("speed").value);
      this.last = now;
      if (this.time >= this.duration) { this.time = this.duration; this.pause(); }
      this.update();
    }
    this.paint();
  }

  paint() {
    const solids = [], ribbons = [], theme = this.theme;
    const visible = this.group.filter((trial) => !this.hidden.has(trial.backend));
    const ordered = visible.sort((a, b) => (b === this.chosen) - (a === this.chosen));
    const front = this.motion(this.chosen);
    const ball = (at, layer, alpha, hue) => solids.push({ kind: "sphere", size: Array(3).fill(2 * DATA.radius), model: Mat.place([1, 0, 0, 0], at), color: hue, alpha, layer });
    ordered.forEach((trial, number) => {
      const motion = this.motion(trial), tint = this.tint(trial.backend), ghost = trial !== this.chosen;
      const layer = ghost ? 1 + number : 0, alpha = ghost ? 0.42 : 1;
      motion.links(this.time).forEach((pose, i) => {
        for (const shape of DATA.robot.links[i].shapes)
          solids.push({ kind: shape.kind, size: shape.size, model: Mat.multiply(pose, Mat.place(shape.turn, shape.at)), color: blend(shape.color.slice(0, 3), tint, ghost ? 0.85 : 0.62), alpha, layer });
      });
      for (const at of motion.markersAt(this.time))
        solids.push({ kind: "sphere", size: [0.03, 0.03, 0.03], model: Mat.place([1, 0, 0, 0], at), color: tint, alpha, layer });
      const place = motion.ballAt(this.time), plan = motion.planAt(this.time);
      const own = [];
      if (place) ball(place, layer, ghost ? 0.5 : 1, ghost ? tint : theme.ball);
      const from = motion.event.throw ?? 0, start = motion.event.onset ?? Infinity;
      own.push({ points: motion.way(motion.ball, "position", from, this.time), color: ghost ? tint : theme.ball, alpha: ghost ? 0.5 : 0.85, width: 2 });
      own.push({ points: motion.way(motion.hand, "position", start, this.time), color: tint, alpha: ghost ? 0.7 : 1, width: 3 });
      // Later lines lie over earlier ones: those of the trial in front come last.
      ribbons.unshift(own);
      if (!plan) return;
      const hit = motion.event.touch ?? motion.event.ball_landed ?? Infinity;
      if (this.time <= hit) own.push({ points: dotted(plan.path), color: blend(tint, theme.ball, ghost ? 0 : 0.5), alpha: ghost ? 0.4 : 0.9, width: ghost ? 1.5 : 2.5 });
      if (plan.target) {
        const size = trial.voxel || 0.01;
        solids.push({ kind: "box", size: [size, size, size], model: Mat.place([1, 0, 0, 0], plan.target), color: ghost ? tint : theme.target, alpha, layer, bright: true });
        own.push({ points: frame(plan.target, 0.04), color: ghost ? tint : theme.target, alpha: ghost ? 0.6 : 1, width: 2 });
      }
    });
    const plan = front.planAt(this.time);
    const target = this.camera.target || front.handAt(this.time) || (plan && plan.target) || [1, 0, 1.4];
    const yaw = this.camera.yaw * Math.PI / 180, pitch = this.camera.pitch * Math.PI / 180;
    // A narrow picture is taken from farther away, so that as much of the width is seen.
    const away = this.camera.distance / Math.min(1, this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight) / 1.35);
    const eye = [target[0] + away * Math.cos(pitch) * Math.cos(yaw), target[1] + away * Math.cos(pitch) * Math.sin(yaw), target[2] + away * Math.sin(pitch)];
    this.scene.draw({ camera: { eye, target, view: VIEW_ANGLE }, theme, solids, ribbons: ribbons.flat(), boxes: DATA.robot ? DATA.robot.boxes : [] });
  }
}

// The edges of a cube about a point.
function frame(center, half) {
  const out = [];
  for (let axis = 0; axis < 3; axis++)
    for (const a of [-half, half])
      for (const b of [-half, half]) {
        const from = [...center], u = (axis + 1) % 3, v = (axis + 2) % 3;
        from[u] += a; from[v] += b; from[axis] -= half;
        const to = [...from];
        to[axis] += 2 * half;
        out.push(...from, ...to);
      }
  return out;
}

const player = new Player();
