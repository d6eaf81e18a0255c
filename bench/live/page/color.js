// Colours of the page's own making: the colour map of ranges and remissions, and the series of plots.

// Viridis (matplotlib, CC0): even steps look even, also in grey and to most colour-blind eyes. Polynomial of degree 6 by
// Matt Zucker (public domain), within 1/255 or so of the table.
const VIRIDIS = [
  [0.2777273272234177, 0.005407344544966578, 0.3340998053353061],
  [0.1050930431085774, 1.404613529898575, 1.384590162594685],
  [-0.3308618287255563, 0.214847559468213, 0.09509516302823659],
  [-4.634230498983486, -5.799100973351585, -19.33244095627987],
  [6.228269936347081, 14.17993336680509, 56.69055260068105],
  [4.776384997670288, -13.74514537774601, -65.35303263337234],
  [-5.435455855934631, 4.645852612178535, 26.3124352495832],
];

/// 256 colours, red green blue from 0 to 255 in a row.
export const RAMP = new Uint8ClampedArray(256 * 3);
for (let i = 0; i < 256; i++)
  for (let band = 0; band < 3; band++) {
    let value = 0;
    for (let k = 6; k >= 0; k--) value = value * (i / 255) + VIRIDIS[k][band];
    RAMP[i * 3 + band] = value * 255;
  }

export const rampCss = `linear-gradient(to right, ${Array.from({ length: 9 }, (_, i) => {
  const at = Math.round((i * 255) / 8) * 3;
  return `rgb(${RAMP[at]} ${RAMP[at + 1]} ${RAMP[at + 2]})`;
}).join(", ")})`;

/// A colour of the page's style, as it is now (light or dark).
export const themeColor = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/// Colours of a plot's series, in the order in which they are told apart best.
export const seriesColors = () => Array.from({ length: 6 }, (_, i) => themeColor(`--series-${i + 1}`));

/// Limits between which most of the values lie: the shares `low` and `high` of a sample of them. null: there is none.
export function limitsOf(values, { stride = 1, offset = 0, low = 0.02, high = 0.98 } = {}) {
  const count = Math.floor((values.length - offset + stride - 1) / stride);
  const step = Math.max(1, Math.floor(count / 4096)) * stride;
  const found = [];
  for (let i = offset; i < values.length; i += step) if (Number.isFinite(values[i])) found.push(values[i]);
  if (found.length === 0) return null;
  found.sort((a, b) => a - b);
  const from = found[Math.floor(low * (found.length - 1))], to = found[Math.ceil(high * (found.length - 1))];
  return to > from ? [from, to] : [from - 0.5, from + 0.5];
}

/// Limits that follow those of the data without flickering: at once outward, slowly inward.
export class SteadyLimits {
  #now = null;
  follow(limits) {
    if (!limits) return this.#now;
    if (!this.#now) return (this.#now = [...limits]);
    const [a, b] = this.#now, slowly = 0.08;
    this.#now = [limits[0] < a ? limits[0] : a + slowly * (limits[0] - a), limits[1] > b ? limits[1] : b + slowly * (limits[1] - b)];
    return this.#now;
  }
}
