// The rows that came: a list for every column, the oldest first. Bench time is step times period.
class Store {
  constructor() {
    this.begin([], 0);
  }

  begin(columns, period) {
    this.columns = columns;
    this.period = period;
    this.clear();
  }

  clear() {
    this.t = [];
    this.values = new Map(this.columns.map((name) => [name, []]));
    this.events = [];
  }

  append(rows, events) {
    for (const step of rows.step) this.t.push(step * this.period);
    this.columns.forEach((name, i) => {
      const list = this.values.get(name);
      for (const value of rows.values[i] ?? []) list.push(value);
    });
    this.events.push(...events);
  }

  // Forgets what is older than so many seconds; a little late, because taking from the front is slow.
  forget(seconds) {
    const first = this.at(this.last - seconds);
    if (first < 2000 && first < this.t.length / 2) return;
    this.t.splice(0, first);
    for (const list of this.values.values()) list.splice(0, first);
    const oldest = this.t[0] ?? Infinity;
    this.events = this.events.filter((event) => event.t >= oldest || event.t >= this.last - seconds);
  }

  get last() {
    return this.t.length ? this.t[this.t.length - 1] : 0;
  }

  // Index of the first row at or after a time.
  at(time) {
    let low = 0, high = this.t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.t[middle] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // The newest value that a column has.
  newest(name) {
    const list = this.values.get(name) ?? [];
    for (let i = list.length - 1; i >= 0 && i > list.length - 200; i--) if (list[i] !== null) return list[i];
    return null;
  }

  has(name) {
    return (this.values.get(name) ?? []).some((value) => value !== null);
  }

  // A line between two times, as many points as can be seen: the least and the greatest of every piece, so that no peak is lost.
  line(name, from, until, pieces) {
    const list = this.values.get(name) ?? [];
    const first = Math.max(0, this.at(from) - 1), end = Math.min(list.length, this.at(until) + 1);
    const x = [], y = [];
    const size = Math.max(1, Math.ceil((end - first) / pieces));
    if (size < 3) {
      for (let i = first; i < end; i++) {
        if (list[i] === null) continue;
        x.push(this.t[i]);
        y.push(list[i]);
      }
      return { x, y };
    }
    // Pieces begin at whole multiples of their size, so that the line does not flicker as it moves on.
    const offset = Math.round(this.t[first] / this.period) % size;
    for (let start = first - offset; start < end; start += size) {
      let low = -1, high = -1;
      for (let i = Math.max(first, start); i < Math.min(end, start + size); i++) {
        if (list[i] === null) continue;
        if (low < 0 || list[i] < list[low]) low = i;
        if (high < 0 || list[i] > list[high]) high = i;
      }
      for (const i of low === high ? [low] : [Math.min(low, high), Math.max(low, high)]) {
        if (i < 0) continue;
        x.push(this.t[i]);
        y.push(list[i]);
      }
    }
    return { x, y };
  }
}
