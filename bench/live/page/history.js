// A series of numbers from the start of the run in bounded memory: the newest values as they came, everything before as the
// least and the greatest of equally many neighbours. Where room ends, two neighbours become one.
const NEWEST = 4096, BUCKETS = 2048;

export class History {
  #t = new Float64Array(NEWEST);
  #y = new Float64Array(NEWEST);
  #end = 0; // how many values there ever were
  #from = new Float64Array(BUCKETS);
  #least = new Float64Array(BUCKETS);
  #greatest = new Float64Array(BUCKETS);
  #used = 0;
  #each = 8; // values in a bucket
  #inLast = 0; // values in the newest bucket so far; 0: the next value begins one

  get first() {
    return this.#end === 0 ? NaN : this.#used ? this.#from[0] : this.#t[0];
  }
  get last() {
    return this.#end ? this.#y[(this.#end - 1) % NEWEST] : NaN;
  }
  get lastTime() {
    return this.#end ? this.#t[(this.#end - 1) % NEWEST] : -Infinity;
  }

  /// `t` does not go back.
  add(t, y) {
    if (this.#end >= NEWEST) this.#keep(this.#t[this.#end % NEWEST], this.#y[this.#end % NEWEST]); // it makes room
    this.#t[this.#end % NEWEST] = t;
    this.#y[this.#end % NEWEST] = y;
    this.#end++;
  }

  #keep(t, y) {
    if (this.#inLast === 0) {
      if (this.#used === BUCKETS) this.#halve();
      this.#from[this.#used] = t;
      this.#least[this.#used] = this.#greatest[this.#used] = y;
      this.#used++;
    } else {
      const i = this.#used - 1; // a value that is no number leaves no trace beside one that is
      if (!(this.#least[i] <= y)) this.#least[i] = Number.isNaN(y) ? this.#least[i] : y;
      if (!(this.#greatest[i] >= y)) this.#greatest[i] = Number.isNaN(y) ? this.#greatest[i] : y;
    }
    this.#inLast = (this.#inLast + 1) % this.#each;
  }

  #halve() {
    for (let i = 0; i < BUCKETS / 2; i++) {
      const a = 2 * i, b = a + 1, least = [this.#least[a], this.#least[b]].filter((v) => !Number.isNaN(v)), greatest = [this.#greatest[a], this.#greatest[b]].filter((v) => !Number.isNaN(v));
      this.#from[i] = this.#from[a];
      this.#least[i] = least.length ? Math.min(...least) : NaN;
      this.#greatest[i] = greatest.length ? Math.max(...greatest) : NaN;
    }
    this.#used = BUCKETS / 2;
    this.#each *= 2;
  }

  /// Calls f(t, least, greatest) in the order of time for what lies in the window, and for one value on either side of it.
  each(from, until, f) {
    for (let i = this.#indexAt((k) => this.#from[k], this.#used, from); i < this.#used; i++) {
      f(this.#from[i], this.#least[i], this.#greatest[i]);
      if (this.#from[i] > until) return;
    }
    const begin = Math.max(0, this.#end - NEWEST);
    const at = (k) => this.#t[(begin + k) % NEWEST];
    for (let k = this.#indexAt(at, this.#end - begin, from); k < this.#end - begin; k++) {
      const y = this.#y[(begin + k) % NEWEST];
      f(at(k), y, y);
      if (at(k) > until) return;
    }
  }

  /// Value at or before t; of a bucket its middle. NaN: there was none.
  at(t) {
    const begin = Math.max(0, this.#end - NEWEST), count = this.#end - begin;
    if (count && this.#t[begin % NEWEST] <= t) return this.#y[(begin + this.#indexAt((k) => this.#t[(begin + k) % NEWEST], count, t)) % NEWEST];
    if (!this.#used || this.#from[0] > t) return NaN;
    const i = this.#indexAt((k) => this.#from[k], this.#used, t);
    return (this.#least[i] + this.#greatest[i]) / 2;
  }

  /// Of `count` times the last at or before t; 0 where all are later.
  #indexAt(time, count, t) {
    let low = 0, high = count - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (time(middle) <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }
}
