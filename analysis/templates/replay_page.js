"use strict";

/* The page: time, controls, lists, keyboard and mouse. */

const SPEEDS = [1, 2, 5, 10, 30, 60, 120, 300, 600];
const PANEL_MS = 200;
const element = (id) => document.getElementById(id);

/** A new element with text or children. */
function make(tag, properties = {}, ...children) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children.filter((child) => child !== null));
  return node;
}

class Player {
  constructor(recording) {
    this.recording = recording;
    this.head = recording.head;
    this.floor = new Floor(recording.head);
    this.scene = new Scene(recording, this.floor);
    this.view = new View();
    this.time = this.head.start;
    this.speed = 10;
    this.playing = false;
    this.followed = null;
    this.tab = "agvs";
    this.frames = { count: 0, drawMs: 0 };
    this.floorDirty = true;
    this.canvases = { floor: element("floor"), scene: element("scene"), track: element("track") };
    this.contexts = Object.fromEntries(Object.entries(this.canvases).map(([name, c]) => [name, c.getContext("2d")]));
    this.timeBar = new TimeBar(this);
    this.panel = new Panel(this);
  }

  start() {
    element("note").textContent = this.head.note + (this.head.status ? ` · ${this.head.status}` : "");
    element("message").hidden = true;
    element("clock").title = this.head.clock.name;
    this.setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    this.measure();
    this.fit();
    listen(this);
    new ResizeObserver(() => { this.measure(); this.redraw(); }).observe(element("stage"));
    new ResizeObserver(() => this.redraw()).observe(element("bar"));
    this.redraw();
  }

  setTheme(theme) {
    document.documentElement.dataset.theme = theme;
    element("theme").textContent = theme === "dark" ? "Light" : "Dark";
    const style = getComputedStyle(document.documentElement);
    this.colors = new Proxy({}, { get: (seen, name) => (seen[name] ??= style.getPropertyValue(`--${name}`).trim()) });
    this.floorDirty = true;
    this.panel.legend();
    this.redraw();
  }

  /** Take over the stage's size; a floor that was fitted stays so. */
  measure() {
    const { clientWidth, clientHeight } = element("stage");
    const fitted = this.fitted;
    Object.assign(this.view, { width: clientWidth, height: clientHeight, ratio: devicePixelRatio || 1 });
    for (const name of ["floor", "scene"]) resize(this.canvases[name], clientWidth, clientHeight, this.view.ratio);
    this.floorDirty = true;
    if (fitted) this.fit();
  }

  fit() {
    this.view.fit(this.floor.bounds);
    this.moved(true);
  }

  zoom(factor, x, y) {
    this.view.zoom(factor, x, y);
    this.moved(false);
  }

  moved(fitted) {
    this.fitted = fitted;
    this.floorDirty = true;
    this.redraw();
  }

  // --- time

  seek(time) {
    this.time = Math.min(this.head.end, Math.max(this.head.start, time));
    this.redraw();
  }

  setSpeed(speed) {
    this.speed = speed;
    element("speed").value = speed;
  }

  faster(by) {
    const k = SPEEDS.indexOf(this.speed) + by;
    this.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, k))]);
  }

  toggle(playing = !this.playing) {
    if (playing && this.time >= this.head.end) this.time = this.head.start;
    this.playing = playing;
    this.last = undefined;
    element("play").textContent = playing ? "❚❚" : "▶";
    element("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    this.redraw();
  }

  /** The beginning of the next or previous deadlock's wait. */
  jump(by) {
    const times = this.head.deadlocks.map((lock) => lock.from).sort((a, b) => a - b);
    const found = by > 0 ? times.find((t) => t > this.time + 1) : times.reverse().find((t) => t < this.time - 1);
    if (found !== undefined) this.seek(found);
  }

  // --- following

  follow(followed) {
    this.followed = followed;
    if (followed) {
      this.view.scale = Math.max(this.view.scale, 9);
      this.moved(false);
    }
    this.panel.refresh();
    this.redraw();
  }

  followNext(by) {
    const now = this.followed?.agv ?? (by > 0 ? -1 : 0);
    this.follow({ agv: (now + by + this.head.agvs) % this.head.agvs });
  }

  /** Move the view towards what is followed. */
  chase() {
    const target = this.followed && this.scene.target(this.scene.state(this.time), this.followed);
    if (!target) return false;
    const far = Math.hypot(target.x - this.view.x, target.y - this.view.y);
    if (far * this.view.scale < 0.5) return false;
    const share = this.playing && this.speed > 30 ? 0.6 : 0.25;
    this.view.x += (target.x - this.view.x) * share;
    this.view.y += (target.y - this.view.y) * share;
    this.floorDirty = true;
    return true;
  }

  // --- frames

  redraw() {
    this.pending ??= requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.pending = undefined;
    if (this.playing) {
      const passed = this.last === undefined ? 0 : Math.min(now - this.last, 250);
      this.time = Math.min(this.head.end, this.time + passed * this.speed);
      this.last = now;
      if (this.time >= this.head.end) this.toggle(false);
    }
    const chasing = this.chase();
    this.draw();
    if (this.playing || chasing) this.redraw();
  }

  draw() {
    const begun = performance.now();
    if (this.floorDirty) this.floor.draw(this.contexts.floor, this.view, this.colors);
    this.floorDirty = false;
    this.scene.draw(this.contexts.scene, this.view, this.colors, this.time, this.followed);
    this.timeBar.draw(this.contexts.track, this.canvases.track);
    this.panel.refreshSoon();
    element("clock").textContent = clock(this.time, this.head.clock);
    this.frames.count++;
    this.frames.drawMs += performance.now() - begun;
  }
}

/** The bar at the bottom: waiting customers, deadlocks, incidents, and where we are. */
class TimeBar {
  constructor(player) {
    this.player = player;
    this.top = 22;
    this.base = 56;
  }

  x(time, width) {
    const { start, end } = this.player.head;
    return ((time - start) / Math.max(1, end - start)) * width;
  }

  time(px) {
    const { start, end } = this.player.head;
    return start + (px / element("bar").clientWidth) * (end - start);
  }

  draw(ctx, canvas) {
    const { clientWidth: width, clientHeight: height } = element("bar");
    const ratio = devicePixelRatio || 1;
    const key = [width, ratio, document.documentElement.dataset.theme].join();
    if (this.key !== key) {
      this.key = key;
      this.still = document.createElement("canvas");
      resize(this.still, width, height, ratio);
      this.drawStill(this.still.getContext("2d"), width, ratio);
    }
    resize(canvas, width, height, ratio);
    clear(ctx);
    ctx.drawImage(this.still, 0, 0);
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const x = this.x(this.player.time, width), { colors } = this.player;
    ctx.fillStyle = colors.link;
    ctx.globalAlpha = 0.13;
    ctx.fillRect(0, this.top, x, this.base - this.top);
    ctx.globalAlpha = 1;
    ctx.fillRect(x - 1, this.top - 4, 2, this.base - this.top + 4);
    ctx.beginPath();
    ctx.arc(x, this.top - 5, 5, 0, 7);
    ctx.fill();
  }

  drawStill(ctx, width, ratio) {
    const { colors, head } = this.player;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.fillStyle = colors.card;
    ctx.fillRect(0, this.top, width, this.base - this.top);
    this.drawArea(ctx, width, (k, c) => c.line_parked[k], colors["slot-edge"], 0.55);
    this.drawArea(ctx, width, (k, c) => c.line_queue[k] + c.line_waiting[k], colors.fetch, 0.75);
    this.drawDeadlocks(ctx, width);
    ctx.fillStyle = colors.bad;
    for (const { time } of head.incidents) this.triangle(ctx, this.x(time, width));
    this.drawScale(ctx, width);
    this.drawCaption(ctx, width);
  }

  /** A tinted band from the beginning of the wait to its end, and a solid foot; where deadlocks overlap it is no darker. */
  drawDeadlocks(ctx, width) {
    const { head, colors } = this.player, bands = new Path2D(), feet = new Path2D();
    for (const lock of head.deadlocks) {
      const from = this.x(Math.max(lock.from, head.start), width), to = this.x(Math.min(lock.to, head.end), width);
      bands.rect(from, this.top, Math.max(2, to - from), this.base - this.top);
      feet.rect(from, this.base - 4, Math.max(3, to - from), 4);
    }
    ctx.fillStyle = colors.lock;
    ctx.globalAlpha = 0.2;
    ctx.fill(bands);
    ctx.globalAlpha = 1;
    ctx.fill(feet);
  }

  drawCaption(ctx, width) {
    const { colors } = this.player;
    let x = width;
    ctx.textAlign = "right";
    for (const [text, color] of [["deadlocks", colors.lock], ["cars parked", colors["slot-edge"]], ["customers waiting", colors.fetch]]) {
      ctx.fillStyle = colors.soft;
      ctx.fillText(text, x, 11);
      x -= ctx.measureText(text).width + 13;
      ctx.fillStyle = color;
      ctx.fillRect(x, 3, 8, 8);
      x -= 14;
    }
  }

  triangle(ctx, x) {
    ctx.beginPath();
    ctx.moveTo(x - 4, this.top - 8);
    ctx.lineTo(x + 4, this.top - 8);
    ctx.lineTo(x, this.top);
    ctx.fill();
  }

  /** A count over time as an area; the highest value of each pixel column. */
  drawArea(ctx, width, value, color, alpha) {
    const c = this.player.recording.columns;
    const highest = new Float64Array(Math.ceil(width) + 1);
    let top = 1;
    let last = 0;
    for (let k = 0; k < c.line_time.length; k++) {
      const x = Math.max(0, Math.round(this.x(c.line_time[k], width)));
      const v = value(k, c);
      for (let p = last + 1; p < x; p++) highest[p] = Math.max(highest[p], v);
      highest[x] = Math.max(highest[x], v);
      last = x;
      top = Math.max(top, v);
    }
    ctx.fillStyle = color;
    ctx.globalAlpha = alpha;
    ctx.beginPath();
    ctx.moveTo(0, this.base);
    highest.forEach((v, x) => ctx.lineTo(x, this.base - (v / top) * (this.base - this.top)));
    ctx.lineTo(width, this.base);
    ctx.fill();
    ctx.globalAlpha = 1;
  }

  drawScale(ctx, width) {
    const { head, colors } = this.player;
    const steps = [10, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400].map((s) => s * 1000);
    const step = steps.find((s) => (width * s) / (head.end - head.start) >= 62) ?? steps[steps.length - 1];
    ctx.fillStyle = colors.soft;
    ctx.font = "11px system-ui, sans-serif";
    const { offset } = head.clock;
    for (let t = Math.ceil((head.start + offset) / step) * step - offset; t <= head.end; t += step) {
      const x = this.x(t, width);
      ctx.fillRect(x, this.base, 1, 4);
      ctx.textAlign = x < 20 ? "left" : x > width - 20 ? "right" : "center";
      const text = clock(t, head.clock).replace(/^day \d+, /, "");
      ctx.fillText(step < 60000 ? text : text.slice(0, -3), x, this.base + 15);
    }
  }

  /** What the pointer is over: the time, and what happened then. */
  tip(px) {
    const tip = element("tip");
    const width = element("bar").clientWidth;
    const time = this.time(px), near = (this.time(6) - this.time(0));
    const { head, recording } = this.player;
    const counts = recording.counts(time);
    const lines = [`${clock(time, head.clock)}   ${counts.parked} parked, ${counts.queue + counts.waiting} waiting`];
    const lock = head.deadlocks.find(({ from, to }) => from - near <= time && time <= Math.max(to, from + near));
    if (lock) lines.push(`deadlock of AGV ${lock.members.join(", ")}: ${lock.end}`);
    const incident = head.incidents.find((mark) => Math.abs(mark.time - time) < near);
    if (incident) lines.push(`${incident.kind} ${incident.who} ${incident.what}`.trim());
    tip.textContent = lines.join("\n");
    tip.hidden = false;
    tip.style.left = `${Math.min(width - tip.offsetWidth / 2, Math.max(tip.offsetWidth / 2, px))}px`;
  }
}

/** The side: counts, a card for what is followed, lists. */
class Panel {
  constructor(player) {
    this.player = player;
    this.list = element("list");
  }

  get place() {
    return (vertex) => (vertex < 0 ? "open" : this.player.head.floor.names[vertex]);
  }

  carName(car) {
    return this.player.head.cars[car];
  }

  /** The side may lag a little behind the floor: it costs more than a frame. */
  refreshSoon() {
    this.timer ??= setTimeout(() => this.refresh(), PANEL_MS);
  }

  refresh() {
    clearTimeout(this.timer);
    this.timer = undefined;
    const state = this.player.scene.state(this.player.time);
    this.counts(state);
    this.card(state);
    element("search").hidden = this.player.tab !== "cars";
    for (const tab of element("tabs").children) tab.setAttribute("aria-selected", tab.dataset.tab === this.player.tab);
    const rows = { agvs: this.agvRows, cars: this.carRows, deadlocks: this.deadlockRows }[this.player.tab].call(this, state);
    const key = JSON.stringify(rows);
    if (key === this.key) return;
    this.key = key;
    this.list.replaceChildren(...(rows.length ? rows.map((row) => this.row(row)) : [this.nothing()]));
  }

  nothing() {
    const text = { agvs: "No AGV.", cars: "No such car.", deadlocks: "No deadlock arose." }[this.player.tab];
    return make("p", { className: "empty", textContent: text });
  }

  counts({ counts }) {
    const { tasks, slots } = this.player.head;
    const shown = [
      ["tasks done", counts.done, tasks], ["cars parked", counts.parked, slots],
      ["cars in the queue", counts.queue, null], ["requests waiting", counts.waiting, null],
    ];
    element("counts").replaceChildren(...shown.map(([name, value, of]) => make("div", {},
      make("dt", { textContent: name }),
      make("dd", {}, `${value}`, of === null ? null : make("small", { textContent: ` / ${of}` })))));
  }

  // --- rows: {color, name, text, bad, battery, follow or seek, pressed}

  agvRows({ agvs, deadlocks }) {
    return agvs.map((agv) => {
      const stuck = deadlocks.some((lock) => lock.members.includes(agv.agv));
      return {
        color: this.player.scene.color(this.player.colors, agv),
        name: `AGV ${agv.agv}`,
        text: stuck ? "in a deadlock" : this.doing(agv),
        bad: stuck,
        battery: agv.soc,
        follow: { agv: agv.agv },
        pressed: this.player.followed?.agv === agv.agv,
      };
    });
  }

  doing(agv) {
    const mode = this.player.head.modes[agv.mode];
    const verb = { "going to collect": "to fetch", "going to park": "parks", "returning with car": "brings" }[mode];
    const c = this.player.recording.columns;
    return verb && agv.task >= 0 ? `${verb} ${this.carName(c.task_car[agv.task])}` : mode.replace("maintenance", "from charging");
  }

  carRows(state) {
    const wanted = element("search").value.trim().toLowerCase();
    const here = new Map(state.cars.map((car) => [car.car, this.standing(car)]));
    for (const agv of state.agvs) if (agv.car >= 0) here.set(agv.car, `on AGV ${agv.agv}`);
    return this.player.head.cars.map((name, car) => ({ name, car, text: here.get(car) ?? "" }))
      .filter(({ name, text }) => (wanted ? name.toLowerCase().includes(wanted) : text))
      .slice(0, 400)
      .map(({ name, car, text }) => ({
        color: CAR_PAINT[car % CAR_PAINT.length], name, text: text || "not in the garage", follow: { car },
        pressed: this.player.followed?.car === car,
      }));
  }

  standing({ place, vertex, handling }) {
    if (place === SLOT) return `in ${this.place(vertex)}`;
    if (place === INBOUND) return `at ${this.place(vertex)}, ${handling ? "customer gets out" : "waits for an AGV"}`;
    return `at ${this.place(vertex)}, customer gets in`;
  }

  deadlockRows({ time }) {
    return this.player.head.deadlocks.map((lock) => ({
      color: this.player.colors.lock,
      name: clock(lock.found, this.player.head.clock),
      text: this.story(lock),
      seek: lock.from,
      pressed: lock.from <= time && time < lock.to,
    }));
  }

  story({ members, where, cause, tried, end }) {
    const failed = tried.length ? `; in vain: ${tried.join(", ")}` : "";
    return `AGV ${members.join(", ")}${where ? ` at ${where}` : ""}: ${cause}${failed} → ${end}`;
  }

  row({ color, name, text, bad, battery, follow, seek, pressed }) {
    const act = () => (follow ? this.player.follow(pressed ? null : follow) : this.player.seek(seek));
    const dot = make("i", { className: "dot" });
    dot.style.setProperty("--dot", color);
    const node = make("button", { className: follow ? "row" : "row lock", onclick: act, title: text }, dot,
      make("b", { textContent: name }), make("span", { textContent: text, className: bad ? "bad" : "" }),
      battery === undefined ? null : this.battery(battery));
    node.setAttribute("aria-pressed", pressed);
    return node;
  }

  battery(soc) {
    const level = make("i");
    level.style.width = `${soc}%`;
    return make("div", { className: soc < 30 ? "battery low" : "battery", title: `battery ${soc} %` }, level);
  }

  // --- what is followed

  card(state) {
    const { followed, scene } = this.player;
    element("card").hidden = element("following").hidden = !followed;
    if (!followed) return;
    const [title, rows] = followed.agv !== undefined ? this.agvCard(state) : this.carCard(state);
    element("following").replaceChildren("following ", make("b", { textContent: title }));
    const close = make("button", { textContent: "✕", title: "Stop following (esc)", onclick: () => this.player.follow(null) });
    const dot = make("i", { className: "dot" });
    if (followed.agv !== undefined) dot.style.setProperty("--dot", scene.color(this.player.colors, state.agvs[followed.agv]));
    const table = make("table", {}, ...rows.map(([key, value]) => make("tr", {},
      make("th", { textContent: key }), make("td", { textContent: value }))));
    element("card").replaceChildren(make("h3", {}, dot, title, close), table);
  }

  agvCard(state) {
    const agv = state.agvs[this.player.followed.agv], c = this.player.recording.columns;
    const rows = [["state", this.player.head.modes[agv.mode]]];
    if (agv.task >= 0) {
      rows.push(["car", this.carName(c.task_car[agv.task])]);
      rows.push(["way", `${this.place(c.task_from[agv.task])} → ${this.place(c.task_to[agv.task])}`]);
    }
    rows.push(["speed", `${agv.speed.toFixed(1)} m/s`], ["battery", `${agv.soc} %`]);
    const lock = state.deadlocks.find(({ members }) => members.includes(agv.agv));
    if (lock) rows.push(["deadlock", this.story(lock)]);
    return [`AGV ${agv.agv}`, rows];
  }

  carCard(state) {
    const { car } = this.player.followed;
    const stay = state.cars.find((other) => other.car === car), agv = state.agvs.find((other) => other.car === car);
    const rows = [["where", agv ? `on AGV ${agv.agv}` : stay ? this.standing(stay) : "not in the garage"]];
    const c = this.player.recording.columns;
    if (agv) rows.push(["way", `${this.place(c.task_from[agv.task])} → ${this.place(c.task_to[agv.task])}`]);
    return [this.carName(car), rows];
  }

  // --- legend

  legend() {
    const entries = [
      ["AGV fetches a car", this.agvKey("fetch")], ["two-way lane", this.laneKey("two", 9)],
      ["AGV with a car", this.agvKey("carry")], ["one-way lane", this.laneKey("one", 7)],
      ["AGV goes home", this.agvKey("home-bound")], ["slot", this.placeKey("slot")],
      ["AGV charges", this.agvKey("charge")], ["bay", this.placeKey("bay")],
      ["AGV is idle", this.agvKey("idle")], ["home", this.placeKey("home")],
      ["way granted", this.lineKey([])], ["charger", this.placeKey("charger")],
      ["way planned", this.lineKey([4, 4])], ["refuge", this.placeKey("refuge")],
      ["deadlock", this.ringKey()], ["customer at the car", this.dotKey()],
    ];
    element("legend-rows").replaceChildren(...entries.map(([text, draw]) => make("div", {}, this.icon(draw), text)));
  }

  icon(draw) {
    const canvas = make("canvas"), ratio = devicePixelRatio || 1;
    resize(canvas, 34, 20, ratio);
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw(ctx, this.player.colors);
    return canvas;
  }

  agvKey(name) {
    return (ctx, colors) => {
      ctx.fillStyle = colors[name];
      ctx.beginPath();
      ctx.roundRect(3, 4, 28, 12, 3);
      ctx.fill();
      ctx.fillStyle = name === "carry" ? CAR_PAINT[1] : colors.paper;
      if (name === "carry") ctx.fillRect(5, 6, 24, 8);
      else ctx.fillRect(27, 6, 2, 8);
    };
  }

  laneKey(name, width) {
    return (ctx, colors) => {
      ctx.fillStyle = colors[name];
      ctx.fillRect(0, 10 - width / 2, 34, width);
      ctx.strokeStyle = name === "two" ? colors.slab : colors.arrow;
      ctx.setLineDash(name === "two" ? [5, 4] : []);
      ctx.beginPath();
      if (name === "two") ctx.moveTo(0, 10);
      else for (const x of [10, 22]) { ctx.moveTo(x - 2, 7.5); ctx.lineTo(x + 1, 10); ctx.lineTo(x - 2, 12.5); }
      if (name === "two") ctx.lineTo(34, 10);
      ctx.lineWidth = 1.4;
      ctx.stroke();
    };
  }

  placeKey(name) {
    return (ctx, colors) => {
      ctx.fillStyle = colors[name];
      ctx.strokeStyle = colors[`${name}-edge`];
      ctx.fillRect(4, 4.5, 26, 11);
      ctx.strokeRect(4, 4.5, 26, 11);
    };
  }

  lineKey(dash) {
    return (ctx, colors) => {
      ctx.strokeStyle = colors.carry;
      ctx.lineWidth = 2.5;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(2, 10);
      ctx.lineTo(32, 10);
      ctx.stroke();
    };
  }

  ringKey() {
    return (ctx, colors) => {
      ctx.strokeStyle = colors.lock;
      ctx.lineWidth = 2.5;
      ctx.beginPath();
      ctx.arc(17, 10, 7.5, 0, 7);
      ctx.stroke();
    };
  }

  dotKey() {
    return (ctx, colors) => {
      ctx.fillStyle = CAR_PAINT[1];
      ctx.fillRect(3, 3, 28, 9);
      ctx.fillStyle = colors.ink;
      ctx.beginPath();
      ctx.arc(17, 16.5, 2.6, 0, 7);
      ctx.fill();
    };
  }
}

// --- input

function listen(player) {
  element("play").onclick = () => player.toggle();
  element("speed").append(...SPEEDS.map((speed) => make("option", { value: speed, textContent: `${speed}×` })));
  element("speed").onchange = (event) => player.setSpeed(Number(event.target.value));
  player.setSpeed(player.speed);
  element("theme").onclick = () => player.setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  element("help-button").onclick = element("help-close").onclick = toggleHelp;
  element("search").oninput = () => player.panel.refresh();
  element("tabs").onclick = (event) => {
    player.tab = event.target.dataset.tab ?? player.tab;
    player.panel.refresh();
  };
  element("zoom").onclick = (event) => ACTIONS[event.target.dataset.do]?.(player);
  listenStage(player, element("stage"));
  listenBar(player, element("bar"));
  addEventListener("keydown", (event) => pressKey(player, event));
}

const ACTIONS = {
  zoomIn: (player) => player.zoom(1.4),
  zoomOut: (player) => player.zoom(1 / 1.4),
  fit: (player) => { player.follow(null); player.fit(); },
};

const KEYS = {
  " ": (player) => player.toggle(),
  ArrowLeft: (player, { shiftKey }) => player.seek(player.time - (shiftKey ? 60000 : 5000)),
  ArrowRight: (player, { shiftKey }) => player.seek(player.time + (shiftKey ? 60000 : 5000)),
  ArrowUp: (player) => player.faster(1),
  ArrowDown: (player) => player.faster(-1),
  Home: (player) => player.seek(player.head.start),
  End: (player) => player.seek(player.head.end),
  "+": ACTIONS.zoomIn, "=": ACTIONS.zoomIn, "-": ACTIONS.zoomOut, "0": ACTIONS.fit,
  n: (player) => player.jump(1),
  p: (player) => player.jump(-1),
  f: (player, { shiftKey }) => player.followNext(shiftKey ? -1 : 1),
  t: () => element("theme").click(),
  l: () => { element("legend").open = !element("legend").open; },
  "?": toggleHelp, h: toggleHelp,
  Escape: (player) => (element("help").hidden ? player.follow(null) : toggleHelp()),
};

function pressKey(player, event) {
  const typing = ["INPUT", "SELECT"].includes(event.target.tagName);
  if (event.ctrlKey || event.metaKey || event.altKey || (typing && event.key !== "Escape")) return;
  const act = KEYS[event.key] ?? KEYS[event.key.toLowerCase()];
  if (!act) return;
  event.preventDefault();
  if (typing || event.target.tagName === "BUTTON") event.target.blur();
  act(player, event);
}

function toggleHelp() {
  element("help").hidden = !element("help").hidden;
}

function listenStage(player, stage) {
  let drag = null;
  const point = (event) => {
    const box = stage.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const under = (event) => player.scene.at(...player.view.toWorld(...point(event)), 12 / player.view.scale);
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    player.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), ...point(event));
  }, { passive: false });
  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest("#zoom, #legend")) return;
    drag = { at: point(event), moved: false };
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!drag) {
      stage.classList.toggle("pointing", under(event) !== null);
      return;
    }
    const [x, y] = point(event), [x0, y0] = drag.at;
    if (!drag.moved && Math.hypot(x - x0, y - y0) < 4) return;
    if (!drag.moved) player.follow(null);
    stage.classList.add("dragging");
    Object.assign(drag, { at: [x, y], moved: true });
    player.view.x -= (x - x0) / player.view.scale;
    player.view.y += (y - y0) / player.view.scale;
    player.moved(false);
  });
  const drop = (event) => {
    if (drag && !drag.moved && event.type === "pointerup") player.follow(under(event));
    drag = null;
    stage.classList.remove("dragging");
  };
  stage.addEventListener("pointerup", drop);
  stage.addEventListener("pointercancel", drop);
}

function listenBar(player, bar) {
  const px = (event) => Math.min(bar.clientWidth, Math.max(0, event.clientX - bar.getBoundingClientRect().left));
  const scrub = (event) => player.seek(player.timeBar.time(px(event)));
  bar.addEventListener("pointerdown", (event) => {
    bar.setPointerCapture(event.pointerId);
    scrub(event);
  });
  bar.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) scrub(event);
    player.timeBar.tip(px(event));
  });
  bar.addEventListener("pointerleave", () => { element("tip").hidden = true; });
}

// --- start

/** For scripts and tests: what is drawn, and the same deeds as the keys'. */
function api(player) {
  return {
    get view() { return { x: player.view.x, y: player.view.y, scale: player.view.scale }; },
    get time() { return player.time; },
    get playing() { return player.playing; },
    get drawn() { return player.scene.drawn; },
    get head() { return player.head; },
    get frames() { return { ...player.frames }; },
    state: (time) => player.scene.state(time),
    seek: (time) => { player.seek(time); player.draw(); },
    draw: () => player.draw(),
    play: (speed) => { player.setSpeed(speed ?? player.speed); player.toggle(true); },
    pause: () => player.toggle(false),
    follow: (followed) => player.follow(followed),
    toScreen: (x, y) => player.view.toScreen(x, y),
  };
}

unpack(element("data").textContent.trim()).then((unpacked) => {
  const player = new Player(new Recording(unpacked));
  player.start();
  player.draw();
  window.replay = api(player);
}).catch((error) => {
  element("message").textContent = error.message;
  throw error;
});
