"use strict";

/* Drawing: the floor on one canvas, redrawn when the view changes; what moves on another one above it. */

const CAR_LENGTH = 4.3, CAR_WIDTH = 1.75, QUEUE_GAP = 6.5;
const CAR_PAINT = ["#8d99ab", "#b9c0c9", "#5f7088", "#a1877b", "#7c8f86", "#7d7f95", "#9c6b64", "#cfd2d3"];
const GROUPS = {
  "idle": "idle", "going to collect": "fetch", "going to park": "carry", "returning with car": "carry",
  "returning home empty": "home-bound", "returning home maintenance": "home-bound",
  "going to charge": "charge", "charging": "charge",
};
const DETAIL = 12, LABELS = 5, SLOT_NAMES = 24;
const QUEUE_SHOWN = 20;

/** What is seen: the world point in the middle, and pixels a metre. */
class View {
  constructor() {
    Object.assign(this, { x: 0, y: 0, scale: 8, width: 1, height: 1, ratio: 1 });
  }

  /** Transform from metres (north up) to the canvas's pixels, for a body at a place if given. */
  apply(ctx, x = 0, y = 0, angle = 0) {
    const s = this.scale * this.ratio, cos = Math.cos(angle) * s, sin = Math.sin(angle) * s;
    ctx.setTransform(cos, -sin, -sin, -cos, (this.width / 2) * this.ratio + (x - this.x) * s,
      (this.height / 2) * this.ratio - (y - this.y) * s);
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** So many metres, but no fewer and no more pixels than given. */
  thick(metres, least, most) {
    return Math.min(Math.max(metres, least / this.scale), most / this.scale);
  }

  sees(x, y, margin = 4) {
    return Math.abs(x - this.x) < this.width / 2 / this.scale + margin
      && Math.abs(y - this.y) < this.height / 2 / this.scale + margin;
  }

  fit([left, bottom, right, top]) {
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    this.scale = 0.95 * Math.min(this.width / (right - left), this.height / (top - bottom));
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(80, Math.max(0.5, this.scale * factor));
    const [nx, ny] = this.toWorld(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }
}

/** Fit a canvas to its box; true if that changed it. */
function resize(canvas, width, height, ratio) {
  const w = Math.round(width * ratio), h = Math.round(height * ratio);
  if (canvas.width === w && canvas.height === h) return false;
  canvas.width = w;
  canvas.height = h;
  return true;
}

function clear(ctx) {
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.clearRect(0, 0, ctx.canvas.width, ctx.canvas.height);
}

/** A polyline of centimetres as points in metres. */
function metres(flat) {
  const points = [];
  for (let k = 0; k < flat.length; k += 2) points.push([flat[k] / 100, flat[k + 1] / 100]);
  return points;
}

function trace(path, points) {
  points.forEach(([x, y], k) => (k ? path.lineTo(x, y) : path.moveTo(x, y)));
}

/** Add a rectangle, turned and shifted forward, to a path. Browsers take their time over closePath in a long path. */
function addBox(path, x, y, angle, length, width, forward = 0) {
  const c = Math.cos(angle), s = Math.sin(angle), a = length / 2, b = width / 2;
  const corner = (u, v) => [x + c * (u + forward) - s * v, y + s * (u + forward) + c * v];
  path.moveTo(...corner(a, b));
  path.lineTo(...corner(a, -b));
  path.lineTo(...corner(-a, -b));
  path.lineTo(...corner(-a, b));
  path.lineTo(...corner(a, b));
}

/** The point so far along a polyline from its end, and the direction there; null before its start. */
function fromEnd(points, distance) {
  for (let k = points.length - 1; k > 0; k--) {
    const [x1, y1] = points[k], [x0, y0] = points[k - 1];
    const length = Math.hypot(x1 - x0, y1 - y0);
    if (distance <= length && length > 0) {
      const share = distance / length;
      return { x: x1 + (x0 - x1) * share, y: y1 + (y0 - y1) * share, angle: Math.atan2(y1 - y0, x1 - x0) };
    }
    distance -= length;
  }
  return null;
}

class Floor {
  constructor(head) {
    this.head = head;
    this.xy = head.floor.xy.map(([x, y]) => [x / 100, y / 100]);
    this.lanes = head.floor.lanes.map(([kind, tail, head, ...flat]) => ({ kind, tail, head, points: metres(flat) }));
    this.spurs = new Map();
    for (const { tail, head, points } of this.lanes.filter(({ kind }) => kind === SPUR)) {
      this.spurs.set(`${tail} ${head}`, points.slice(1, -1)).set(`${head} ${tail}`, points.slice(1, -1).reverse());
    }
    this.places = head.floor.places.map(([role, vertex, x, y, angle, spur, number]) => ({
      role, vertex, x: x / 100, y: y / 100, angle: (angle / 1800) * Math.PI, spur, number,
    }));
    this.placeOf = new Map(this.places.map((place) => [place.vertex, place]));
    this.streets = head.floor.streets.map(([part, flat]) => ({ part, points: metres(flat) }));
    this.queue = this.queueLine();
    this.bounds = this.extent();
    this.paths = this.build();
    this.names = this.placeNames();
  }

  /** Corners of the garage, and of the street beside it. */
  extent() {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    const take = (x, y, margin) => {
      box[0] = Math.min(box[0], x - margin);
      box[1] = Math.min(box[1], y - margin);
      box[2] = Math.max(box[2], x + margin);
      box[3] = Math.max(box[3], y + margin);
    };
    this.xy.forEach(([x, y]) => take(x, y, 4));
    this.places.forEach(({ x, y }) => take(x, y, 4));
    this.slab = [...box];
    for (const { points } of this.streets) {
      for (const [x, y] of points) {
        if (y > this.slab[1] - 30 && y < this.slab[3] + 30 && x > this.slab[0] - 30 && x < this.slab[2] + 30) {
          take(x, Math.min(this.slab[3], Math.max(this.slab[1], y)), 3.5);
        }
      }
    }
    const queue = this.queue.length > 1 ? fromEnd(this.queue, QUEUE_SHOWN) : null;
    if (queue) take(queue.x, queue.y, 1);
    return box;
  }

  build() {
    const paths = { two: new Path2D(), one: new Path2D(), spur: new Path2D(), arrows: new Path2D(), street: new Path2D() };
    for (const { kind, points } of this.lanes) {
      trace([paths.two, paths.one, paths.spur][kind], points);
      if (kind === 1) this.addArrow(paths.arrows, points[0], points[points.length - 1]);
    }
    for (const { points } of this.streets) trace(paths.street, points);
    for (const { role, x, y, angle, spur } of this.places) {
      paths[role] ??= new Path2D();
      const { length, width } = this.head;
      if (spur) addBox(paths[role], x, y, angle, length + 0.5, width + 0.35);
      else addBox(paths[role], x, y, 0, role === "home" ? 3.4 : 4.4, role === "home" ? 3.4 : 4.4);
    }
    return paths;
  }

  addArrow(path, [x0, y0], [x1, y1]) {
    const angle = Math.atan2(y1 - y0, x1 - x0), c = Math.cos(angle), s = Math.sin(angle);
    const x = x0 + (x1 - x0) * 0.5, y = y0 + (y1 - y0) * 0.5;
    const at = (u, v) => [x + c * u - s * v, y + s * u + c * v];
    path.moveTo(...at(-0.7, 0.85));
    path.lineTo(...at(0.55, 0));
    path.lineTo(...at(-0.7, -0.85));
  }

  /** Where a body stands at a vertex. */
  standing(vertex) {
    const place = this.placeOf.get(vertex);
    return place?.spur ? [place.x, place.y] : this.xy[vertex];
  }

  /** Points of the way along vertices. */
  way(path) {
    return path.flatMap((vertex, k) => [...(this.spurs.get(`${path[k - 1]} ${vertex}`) ?? []), this.standing(vertex)]);
  }

  /** The street on which cars wait, up to where the first of them stands. */
  queueLine() {
    const part = (name) => this.streets.find((street) => street.part === name)?.points ?? [];
    return [...part("entry"), ...part("queue")];
  }

  placeNames() {
    const letters = { bay: "B", charger: "C", refuge: "R" };
    return this.places.filter(({ role }) => letters[role])
      .map((place) => ({ ...place, text: letters[place.role] + place.number }));
  }

  draw(ctx, view, colors) {
    clear(ctx);
    view.apply(ctx);
    ctx.lineJoin = "round";
    const [left, bottom, right, top] = this.slab;
    ctx.fillStyle = colors.slab;
    ctx.beginPath();
    ctx.roundRect(left, bottom, right - left, top - bottom, 2);
    ctx.fill();
    this.drawStreet(ctx, colors);
    this.drawLanes(ctx, colors);
    for (const role of ["slot", "refuge", "charger", "bay", "home"]) {
      if (!this.paths[role]) continue;
      ctx.fillStyle = colors[role];
      ctx.fill(this.paths[role]);
      this.stroke(ctx, this.paths[role], colors[`${role}-edge`], view.thick(0.12, 0.7, 2));
    }
    this.drawNames(ctx, view, colors);
  }

  drawStreet(ctx, colors) {
    ctx.lineCap = "butt";
    this.stroke(ctx, this.paths.street, colors.street, 3.6);
    ctx.setLineDash([2, 2.5]);
    this.stroke(ctx, this.paths.street, colors["street-line"], 0.16);
    ctx.setLineDash([]);
  }

  drawLanes(ctx, colors) {
    this.stroke(ctx, this.paths.spur, colors.spur, 1.5);
    ctx.lineCap = "round";
    this.stroke(ctx, this.paths.one, colors.one, 2.3);
    this.stroke(ctx, this.paths.two, colors.two, 2.9);
    ctx.lineCap = "butt";
    ctx.setLineDash([1.5, 1.25]);
    this.stroke(ctx, this.paths.two, colors.slab, 0.22);
    ctx.setLineDash([]);
    ctx.lineCap = "round";
    this.stroke(ctx, this.paths.arrows, colors.arrow, 0.4);
  }

  drawNames(ctx, view, colors) {
    if (view.scale < LABELS) return;
    ctx.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.font = `600 ${Math.min(16, 1.5 * view.scale)}px system-ui, sans-serif`;
    for (const { role, x, y, text } of this.names) {
      ctx.fillStyle = colors[`${role}-edge`];
      ctx.fillText(text, ...view.toScreen(x, y));
    }
    if (view.scale < SLOT_NAMES) return;
    ctx.font = "10px system-ui, sans-serif";
    ctx.fillStyle = colors.soft;
    for (const { role, x, y, vertex } of this.places) {
      if (role === "slot" && view.sees(x, y)) ctx.fillText(this.head.floor.names[vertex], ...view.toScreen(x, y));
    }
  }

  stroke(ctx, path, color, width) {
    ctx.strokeStyle = color;
    ctx.lineWidth = width;
    ctx.stroke(path);
  }
}

class Scene {
  constructor(recording, floor) {
    this.recording = recording;
    this.floor = floor;
    this.drawn = { time: -1, agvs: [], cars: [] };
    const { length, width } = recording.head;
    this.chassis = new Path2D();
    this.chassis.roundRect(-length / 2, -width / 2, length, width, 0.4);
    this.nose = new Path2D();
    this.nose.roundRect(length / 2 - 0.62, -width / 2 + 0.3, 0.34, width - 0.6, 0.15);
    this.body = new Path2D();
    this.body.roundRect(-CAR_LENGTH / 2, -CAR_WIDTH / 2, CAR_LENGTH, CAR_WIDTH, [0.5, 0.7, 0.7, 0.5]);
    this.glass = new Path2D();
    this.glass.roundRect(0.3, -0.68, 0.75, 1.36, [0.1, 0.3, 0.3, 0.1]);
    this.glass.roundRect(-1.65, -0.62, 0.45, 1.24, [0.25, 0.1, 0.1, 0.25]);
  }

  /** Everything there is at a time, in metres and radians. */
  state(time) {
    const { recording } = this, cars = [];
    recording.eachStay(time, (k) => cars.push(this.stay(k, time)));
    const agvs = Array.from({ length: recording.agvs }, (_, agv) => {
      const pose = recording.pose(agv, time);
      const task = recording.task(agv, time);
      return { ...pose, task, car: recording.carried(agv, time), goal: recording.goal(task, time) };
    });
    return { time, agvs, cars, counts: recording.counts(time), deadlocks: recording.deadlocks(time) };
  }

  stay(k, time) {
    const c = this.recording.columns;
    return {
      car: c.stay_car[k], x: c.stay_x[k] / 100, y: c.stay_y[k] / 100, angle: (c.stay_angle[k] / 1800) * Math.PI,
      place: c.stay_place[k], vertex: c.stay_vertex[k],
      handling: c.stay_place[k] === INBOUND && time < c.stay_ready[k],
    };
  }

  draw(ctx, view, colors, time, followed) {
    const state = this.state(time);
    this.drawn = state;
    clear(ctx);
    this.drawCars(ctx, view, colors, state.cars);
    this.drawQueue(ctx, view, colors, state.counts.queue);
    for (const agv of state.agvs) this.drawPlan(ctx, view, colors, agv, time, followed);
    for (const agv of state.agvs) this.drawAgv(ctx, view, colors, agv);
    for (const lock of state.deadlocks) this.drawDeadlock(ctx, view, colors, lock, state.agvs);
    this.drawNumbers(ctx, view, colors, state.agvs);
    this.drawFollowed(ctx, view, colors, state, followed);
    return state;
  }

  color(colors, agv) {
    return colors[GROUPS[this.recording.head.modes[agv.mode]]];
  }

  // --- cars

  drawCars(ctx, view, colors, cars) {
    const seen = cars.filter(({ x, y }) => view.sees(x, y));
    if (view.scale >= DETAIL) seen.forEach((car) => this.drawCar(ctx, view, colors, car));
    else this.drawSmallCars(ctx, view, colors, seen);
    for (const { x, y, angle } of seen.filter((car) => car.handling)) {
      view.apply(ctx, x, y, angle);
      ctx.fillStyle = colors.ink;
      ctx.beginPath();
      ctx.arc(0, -1.7, 0.42, 0, 7);
      ctx.fill();
    }
  }

  /** One car with its glass and outline. */
  drawCar(ctx, view, colors, { car, x, y, angle }) {
    view.apply(ctx, x, y, angle);
    ctx.fillStyle = CAR_PAINT[car % CAR_PAINT.length];
    ctx.fill(this.body);
    ctx.fillStyle = colors.glass;
    ctx.fill(this.glass);
    ctx.strokeStyle = colors["car-edge"];
    ctx.lineWidth = 0.1;
    ctx.stroke(this.body);
  }

  /** Many cars at once: one path for each paint. */
  drawSmallCars(ctx, view, colors, cars) {
    view.apply(ctx);
    const bodies = CAR_PAINT.map(() => new Path2D()), glass = new Path2D();
    for (const { car, x, y, angle } of cars) {
      addBox(bodies[car % CAR_PAINT.length], x, y, angle, CAR_LENGTH, CAR_WIDTH);
      addBox(glass, x, y, angle, 0.7, 1.3, 0.65);
    }
    bodies.forEach((path, k) => {
      ctx.fillStyle = CAR_PAINT[k];
      ctx.fill(path);
    });
    ctx.fillStyle = colors.glass;
    ctx.fill(glass);
  }

  /** Cars that wait in the street, as far as it is drawn, and how many more there are. */
  drawQueue(ctx, view, colors, queue) {
    if (!queue || this.floor.queue.length < 2) return;
    const line = [];
    for (let k = 0; k < queue; k++) {
      const at = fromEnd(this.floor.queue, 1 + CAR_LENGTH / 2 + k * QUEUE_GAP);
      if (!at) break;
      line.push({ ...at, car: k });
    }
    view.apply(ctx);
    const bodies = new Path2D();
    line.forEach(({ x, y, angle }) => addBox(bodies, x, y, angle, CAR_LENGTH, CAR_WIDTH));
    ctx.fillStyle = colors.soft;
    ctx.fill(bodies);
    if (view.sees(line[0].x, line[0].y)) this.badge(ctx, view, colors, line[0], `${queue} waiting`);
  }

  badge(ctx, view, colors, { x, y }, text) {
    ctx.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
    ctx.font = "600 11px system-ui, sans-serif";
    const width = ctx.measureText(text).width + 12;
    const [sx, sy] = view.toScreen(x, y);
    const px = Math.min(Math.max(sx + 1.8 * view.scale, 4), view.width - width - 4);
    const py = Math.min(Math.max(sy, 14), view.height - 14);
    ctx.fillStyle = colors.ink;
    ctx.beginPath();
    ctx.roundRect(px, py - 9, width, 18, 9);
    ctx.fill();
    ctx.fillStyle = colors.paper;
    ctx.textAlign = "left";
    ctx.textBaseline = "middle";
    ctx.fillText(text, px + 6, py + 0.5);
  }

  // --- AGVs

  drawAgv(ctx, view, colors, agv) {
    if (!view.sees(agv.x, agv.y)) return;
    view.apply(ctx, agv.x, agv.y, agv.angle);
    ctx.fillStyle = this.color(colors, agv);
    ctx.fill(this.chassis);
    ctx.strokeStyle = colors.paper;
    ctx.lineWidth = view.thick(0.12, 1, 2);
    ctx.stroke(this.chassis);
    if (agv.car >= 0) {
      this.drawCar(ctx, view, colors, agv);
    } else {
      ctx.fillStyle = colors.paper;
      ctx.fill(this.nose);
    }
  }

  drawNumbers(ctx, view, colors, agvs) {
    const size = Math.min(20, Math.max(8, 1.25 * view.scale));
    if (view.scale < 2.5) return;
    ctx.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
    ctx.font = `700 ${size}px system-ui, sans-serif`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    for (const agv of agvs) {
      if (!view.sees(agv.x, agv.y)) continue;
      const [x, y] = view.toScreen(agv.x - Math.cos(agv.angle) * 0.35, agv.y - Math.sin(agv.angle) * 0.35);
      ctx.fillStyle = this.color(colors, agv);
      ctx.beginPath();
      ctx.arc(x, y, size * 0.78, 0, 7);
      ctx.fill();
      ctx.fillStyle = colors.paper;
      ctx.fillText(agv.agv, x, y + 0.5);
    }
  }

  /** The way ahead: granted vertices solid, planned ones dashed; a ring where the task leads. */
  drawPlan(ctx, view, colors, agv, time, followed) {
    const { path, granted } = this.recording.plan(agv.agv, time);
    const mine = followed?.agv === agv.agv;
    let gone = 0;
    while (gone < Math.min(3, path.length - 1) && this.passed(agv, path[gone], path[gone + 1])) gone++;
    const ahead = Array.from(path.subarray(gone)), own = Math.max(0, granted - gone);
    view.apply(ctx);
    ctx.globalAlpha = followed && !mine ? 0.3 : 0.85;
    ctx.strokeStyle = this.color(colors, agv);
    ctx.lineJoin = "round";
    ctx.lineCap = "round";
    ctx.lineWidth = mine ? view.thick(0.7, 3, 7) : view.thick(0.45, 2, 5);
    const here = [agv.x, agv.y];
    this.strokeLine(ctx, [here, ...this.floor.way(ahead.slice(0, own))]);
    ctx.setLineDash([2 * ctx.lineWidth, 2.6 * ctx.lineWidth]);
    this.strokeLine(ctx, own ? this.floor.way(ahead.slice(own - 1)) : [here, ...this.floor.way(ahead)]);
    ctx.setLineDash([]);
    if (agv.goal >= 0) this.drawGoal(ctx, agv.goal);
    ctx.globalAlpha = 1;
  }

  /** The AGV's middle lies beyond a vertex, more towards the next one than to a side. */
  passed({ x, y }, vertex, next) {
    const [ax, ay] = this.floor.standing(vertex), [bx, by] = this.floor.standing(next);
    const along = (x - ax) * (bx - ax) + (y - ay) * (by - ay);
    return along > Math.abs((x - ax) * (by - ay) - (y - ay) * (bx - ax));
  }

  strokeLine(ctx, points) {
    if (points.length < 2) return;
    ctx.beginPath();
    trace(ctx, points);
    ctx.stroke();
  }

  drawGoal(ctx, vertex) {
    const place = this.floor.placeOf.get(vertex), [x, y] = this.floor.standing(vertex);
    const { length, width } = this.recording.head;
    ctx.beginPath();
    if (place?.spur) addBox(ctx, x, y, place.angle, length + 1.1, width + 0.9);
    else ctx.arc(x, y, 2.6, 0, 7);
    ctx.stroke();
  }

  // --- marks

  /** Rings around the members, and an arrow from each to the one it waits for. */
  drawDeadlock(ctx, view, colors, { members, waits }, agvs) {
    view.apply(ctx);
    ctx.strokeStyle = colors.lock;
    ctx.lineWidth = view.thick(0.35, 2.5, 4);
    for (const member of members) {
      if (!agvs[member]) continue;
      ctx.beginPath();
      ctx.arc(agvs[member].x, agvs[member].y, 3.5, 0, 7);
      ctx.stroke();
    }
    for (const [from, to] of waits) {
      if (agvs[from] && agvs[to]) this.arrow(ctx, agvs[from], agvs[to]);
    }
  }

  arrow(ctx, from, to) {
    const length = Math.hypot(to.x - from.x, to.y - from.y);
    if (length < 7.2) return;
    const c = (to.x - from.x) / length, s = (to.y - from.y) / length;
    const at = (u, v) => [from.x + c * u - s * v, from.y + s * u + c * v];
    const tip = length - 3.7;
    this.strokeLine(ctx, [at(3.6, 0), at(tip, 0)]);
    this.strokeLine(ctx, [at(tip - 1.3, 1), at(tip, 0), at(tip - 1.3, -1)]);
  }

  drawFollowed(ctx, view, colors, state, followed) {
    const at = this.target(state, followed);
    if (!at) return;
    view.apply(ctx, at.x, at.y, at.angle);
    ctx.strokeStyle = colors.ink;
    ctx.lineWidth = 2 / view.scale;
    ctx.beginPath();
    ctx.roundRect(-3.1, -1.75, 6.2, 3.5, 0.9);
    ctx.stroke();
  }

  /** Where the followed AGV or car is; null when it is in the street or gone. */
  target(state, followed) {
    if (!followed) return null;
    if (followed.agv !== undefined) return state.agvs[followed.agv] ?? null;
    return state.cars.find(({ car }) => car === followed.car) ?? state.agvs.find(({ car }) => car === followed.car) ?? null;
  }

  /** What lies under a point of the world: {agv}, {car} or null. */
  at(x, y, reach) {
    const near = (body) => Math.hypot(body.x - x, body.y - y);
    const nearest = (bodies) => bodies.reduce((best, body) => (!best || near(body) < near(best) ? body : best), null);
    const agv = nearest(this.drawn.agvs);
    if (agv && near(agv) < Math.max(2, reach)) return { agv: agv.agv };
    const car = nearest(this.drawn.cars);
    return car && near(car) < Math.max(1.6, reach / 2) ? { car: car.car } : null;
  }
}
