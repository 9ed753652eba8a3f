"use strict";

/* The record: what was where at a time. Times are milliseconds, places metres, angles radians counter-clockwise. */

const NEVER = 2 ** 30 - 1;
const SLOT = 0, INBOUND = 1, SPUR = 2;

/** Undo analysis.replay.pack: the description, and the columns by name. */
async function unpack(text) {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("This browser is too old for the replay: it can't inflate data (Chromium 80, Firefox 113 or later can).");
  }
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  return { head, columns: readColumns(bytes, 4 + length, head.columns) };
}

/** Numbers are differences, zigzag-coded, seven bits a byte. */
function readColumns(bytes, start, names) {
  const columns = {};
  let at = start;
  for (const [name, length] of names) {
    const values = new Int32Array(length);
    let value = 0;
    for (let k = 0; k < length; k++) {
      let coded = 0, shift = 0, byte;
      do {
        byte = bytes[at++];
        coded |= (byte & 127) << shift;
        shift += 7;
      } while (byte > 127);
      value += (coded >>> 1) ^ -(coded & 1);
      values[k] = value;
    }
    columns[name] = values;
  }
  return columns;
}

/** Index of the last value that is not greater, in values[from..to); from - 1 if there is none. */
function lastAt(values, value, from = 0, to = values.length) {
  while (from < to) {
    const middle = (from + to) >> 1;
    if (values[middle] <= value) from = middle + 1;
    else to = middle;
  }
  return from - 1;
}

/** First index of each group 0..count in a sorted column, and its length at the end. */
function starts(column, count) {
  return Array.from({ length: count + 1 }, (_, group) => lastAt(column, group - 1) + 1);
}

class Recording {
  constructor({ head, columns }) {
    this.head = head;
    this.columns = columns;
    this.agvs = head.agvs;
    this.samples = columns.time.length;
    this.planOf = starts(columns.plan_agv, head.agvs);
    this.taskOf = starts(columns.task_agv, head.agvs);
    this.pathStart = new Int32Array(columns.plan_length.length + 1);
    columns.plan_length.forEach((n, k) => { this.pathStart[k + 1] = this.pathStart[k] + n; });
  }

  /** Where an AGV is: x, y, angle, speed (m/s), mode. A reversal swaps front and rear at once; the body never spins. */
  pose(agv, time) {
    const { time: times, x, y, angle, mode, soc } = this.columns;
    const k = Math.max(0, Math.min(lastAt(times, time), this.samples - 1));
    const next = Math.min(k + 1, this.samples - 1);
    const span = times[next] - times[k];
    const share = span > 0 ? Math.min(1, Math.max(0, (time - times[k]) / span)) : 0;
    const i = agv * this.samples + k, j = agv * this.samples + next;
    const dx = x[j] - x[i], dy = y[j] - y[i];
    let turn = (angle[j] - angle[i]) % 3600;
    if (turn > 1800) turn -= 3600;
    if (turn < -1800) turn += 3600;
    const reversed = share > 0 && Math.abs(turn) > 900;
    const from = reversed ? angle[i] + 1800 : angle[i];
    if (reversed) turn -= Math.sign(turn) * 1800;
    return {
      agv,
      x: (x[i] + dx * share) / 100,
      y: (y[i] + dy * share) / 100,
      angle: ((from + turn * share) / 1800) * Math.PI,
      speed: span > 0 ? (Math.hypot(dx, dy) / span) * 10 : 0,
      mode: mode[i],
      soc: soc[i],
    };
  }

  /** The task of an AGV, or -1. */
  task(agv, time) {
    const { task_assigned: assigned, task_delivered: delivered } = this.columns;
    const k = lastAt(assigned, time, this.taskOf[agv], this.taskOf[agv + 1]);
    return k >= this.taskOf[agv] && time < delivered[k] ? k : -1;
  }

  /** The car on an AGV, or -1. */
  carried(agv, time) {
    const task = this.task(agv, time);
    return task >= 0 && time >= this.columns.task_lifted[task] ? this.columns.task_car[task] : -1;
  }

  /** Vertex an AGV with a task drives to, or -1. */
  goal(task, time) {
    if (task < 0) return -1;
    return time < this.columns.task_lifted[task] ? this.columns.task_from[task] : this.columns.task_to[task];
  }

  /** The plan of an AGV: vertices from the last one reached, and how many of them it owns. */
  plan(agv, time) {
    const k = lastAt(this.columns.plan_time, time, this.planOf[agv], this.planOf[agv + 1]);
    if (k < this.planOf[agv]) return { path: new Int32Array(0), granted: 0 };
    const path = this.columns.plan_path.subarray(this.pathStart[k], this.pathStart[k + 1]);
    return { path, granted: this.columns.plan_granted[k] };
  }

  /** Calls back with the index of each stay of a car at a time. */
  eachStay(time, call) {
    const { stay_from: from, stay_to: to } = this.columns;
    const last = lastAt(from, time);
    for (let k = 0; k <= last; k++) if (time < to[k]) call(k);
  }

  /** Customers waiting, cars in slots, tasks done. */
  counts(time) {
    const c = this.columns;
    const k = Math.max(0, lastAt(c.line_time, time));
    return {
      done: lastAt(c.done, time) + 1,
      queue: c.line_queue[k] ?? 0,
      spilled: c.line_spilled[k] ?? 0,
      waiting: c.line_waiting[k] ?? 0,
      parked: c.line_parked[k] ?? 0,
    };
  }

  /** Deadlocks that last at a time. */
  deadlocks(time) {
    return this.head.deadlocks.filter((lock) => lock.from <= time && time < lock.to);
  }
}

/** A time of the run as its clock shows it: h:mm:ss, of the day where the demand has a time of day; see clock.py. */
function clock(time, { name, offset }) {
  const whole = Math.floor((time + offset) / 1000 + 1e-6), days = name === "time of day" ? Math.floor(whole / 86400) : 0;
  const s = whole - days * 86400;
  const two = (n) => String(n).padStart(2, "0");
  const shown = `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
  return days ? `day ${days + 1}, ${shown}` : shown;
}
