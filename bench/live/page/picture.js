// From sensor_msgs/Image to the pixels of a canvas.
//
// Bits of 16-bit pictures: what `…/settings` says (its PFNC name ends in the number of bits), else the fewest that hold
// the brightest pixel seen.
import { limitsOf, RAMP } from "./color.js";

const BAYER = { bayer_rggb: [0, 0], bayer_grbg: [1, 0], bayer_gbrg: [0, 1], bayer_bggr: [1, 1] }; // where red lies

function words(image, bytesEach) {
  const { data, width, height, step } = image, row = width * bytesEach;
  const tight = step > row ? new Uint8Array(row * height) : data;
  if (step > row) for (let v = 0; v < height; v++) tight.set(data.subarray(v * step, v * step + row), v * row);
  if (bytesEach === 1) return tight;
  const own = tight.slice().buffer;
  if (bytesEach === 2) return new Uint16Array(own);
  return new Float32Array(own);
}

function unpackMono12p(image) {
  const { data, width, height } = image, all = new Uint16Array(width * height);
  for (let i = 0, at = 0; i + 1 < all.length; i += 2, at += 3) {
    all[i] = data[at] | ((data[at + 1] & 0x0f) << 8);
    all[i + 1] = (data[at + 1] >> 4) | (data[at + 2] << 4);
  }
  return all;
}

function gray(values, shift, out) {
  for (let i = 0, o = 0; i < values.length; i++, o += 4) {
    const g = values[i] >> shift;
    out[o] = out[o + 1] = out[o + 2] = g;
    out[o + 3] = 255;
  }
}

/// Each missing colour from the neighbours that have it (bilinear).
function demosaic(values, width, height, [redX, redY], shift, out) {
  const at = (u, v) => values[v * width + u];
  for (let v = 0, o = 0; v < height; v++)
    for (let u = 0; u < width; u++, o += 4) {
      // At the border the mirrored neighbour has the same colour as the one that is missing.
      const l = u > 0 ? u - 1 : 1, r = u < width - 1 ? u + 1 : width - 2, t = v > 0 ? v - 1 : 1, b = v < height - 1 ? v + 1 : height - 2;
      const here = at(u, v), redColumn = (u & 1) === redX, redRow = (v & 1) === redY;
      let red, green, blue;
      if (redColumn === redRow) {
        green = (at(l, v) + at(r, v) + at(u, t) + at(u, b)) >> 2;
        const other = (at(l, t) + at(r, t) + at(l, b) + at(r, b)) >> 2;
        [red, blue] = redRow ? [here, other] : [other, here];
      } else {
        green = here;
        const side = (at(l, v) + at(r, v)) >> 1, up = (at(u, t) + at(u, b)) >> 1;
        [red, blue] = redRow ? [side, up] : [up, side];
      }
      out[o] = red >> shift;
      out[o + 1] = green >> shift;
      out[o + 2] = blue >> shift;
      out[o + 3] = 255;
    }
}

export class PictureDecoder {
  bits = null; // of 16-bit words, once known
  #brightest = 255;
  #image = null;

  /// A pixel format by its PFNC name, from the settings beside the picture.
  settings(pixelFormat) {
    const told = /(?:Mono|Bayer[RGB]{2})(\d+)/.exec(pixelFormat);
    this.bits = told ? Number(told[1]) : this.bits;
  }

  #shift(values) {
    if (values.BYTES_PER_ELEMENT === 1) return 0;
    if (this.bits) return this.bits - 8;
    for (let i = 0; i < values.length; i += 7) if (values[i] > this.#brightest) this.#brightest = values[i];
    return Math.ceil(Math.log2(this.#brightest + 1)) - 8;
  }

  /// Pixels of `image`, with what they mean: {pixels: ImageData, range: [m, m] or undefined, values}. `values` are those
  /// of the range image. `limits` makes of the limits of the data those that are drawn.
  decode(image, limits = (l) => l) {
    const { width, height, encoding } = image;
    if (!(width > 0 && height > 0 && width * height <= 1 << 26)) throw new Error(`a picture of ${width}×${height} pixels`);
    if (this.#image?.width !== width || this.#image?.height !== height) this.#image = new ImageData(width, height);
    const out = this.#image.data;
    const result = { pixels: this.#image };
    const bayer = BAYER[encoding.replace(/(8|16)$/, "")];
    if (bayer && width > 1 && height > 1) {
      const values = words(image, encoding.endsWith("16") ? 2 : 1);
      demosaic(values, width, height, bayer, this.#shift(values), out);
    } else if (encoding === "rgb8" || encoding === "bgr8") {
      const values = words({ ...image, width: width * 3 }, 1), red = encoding === "rgb8" ? 0 : 2;
      for (let i = 0, o = 0; o < out.length; i += 3, o += 4) {
        out[o] = values[i + red];
        out[o + 1] = values[i + 1];
        out[o + 2] = values[i + 2 - red];
        out[o + 3] = 255;
      }
    } else if (encoding === "32FC1") {
      result.values = words(image, 4);
      result.range = limits(limitsOf(result.values)) ?? [0, 1];
      const [from, to] = result.range, scale = 255 / (to - from);
      for (let i = 0, o = 0; i < result.values.length; i++, o += 4) {
        const value = result.values[i];
        const step = Math.max(0, Math.min(255, Math.round((value - from) * scale))) * 3;
        out[o] = RAMP[step];
        out[o + 1] = RAMP[step + 1];
        out[o + 2] = RAMP[step + 2];
        out[o + 3] = Number.isFinite(value) ? 255 : 0; // nothing came back: the ground shows
      }
    } else if (encoding === "mono8" || encoding === "8UC1" || encoding === "mono16" || encoding === "16UC1" || encoding === "mono12p") {
      if (encoding === "mono12p") this.bits = 12;
      const values = encoding === "mono12p" ? unpackMono12p(image) : words(image, encoding.startsWith("8") || encoding === "mono8" ? 1 : 2);
      gray(values, this.#shift(values), out);
    } else {
      throw new Error(`pictures of encoding ${encoding} are not shown`);
    }
    return result;
  }
}
