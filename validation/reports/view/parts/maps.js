// Maps and the mosaic as pictures, and their scales.

const table = (text) => text.split(" ").map((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)));
const VIRIDIS = table("#440154 #482475 #414487 #355f8d #2a788e #21918c #22a884 #44bf70 #7ad151 #bddf26 #fde725");
const TWO_SIDED = table("#b35806 #f1a340 #fee0b6 #f7f7f7 #d8daeb #998ec3 #542788");
const UNKNOWN = [127, 127, 127];
const TINT = { R: [1, 0.35, 0.3], G: [0.35, 1, 0.35], B: [0.4, 0.55, 1], IR: [0.95, 0.7, 1] };
const TICKS = 5;

function between(colours, share) {
  const at = Math.min(Math.max(share, 0), 1) * (colours.length - 1), i = Math.min(Math.floor(at), colours.length - 2);
  return colours[i].map((part, k) => Math.round(part + (at - i) * (colours[i + 1][k] - part)));
}

function painted(width, height, fill) {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d"), image = context.createImageData(width, height);
  fill(image.data);
  context.putImageData(image, 0, 0);
  return canvas;
}

function colouredMap(values, width, height, { low, high, colours }) {
  const steps = Array.from({ length: 256 }, (_, i) => between(colours, i / 255));
  return painted(width, height, (pixels) => {
    for (let i = 0; i < values.length; i++) {
      const share = high > low ? (values[i] - low) / (high - low) : 0.5;
      const colour = Number.isNaN(share) ? UNKNOWN : steps[Math.round(Math.min(Math.max(share, 0), 1) * 255)];
      pixels.set(colour, i * 4);
      pixels[i * 4 + 3] = 255;
    }
  });
}

// The smallest value above a share of all known ones.
function quantile(values, share) {
  const known = Float32Array.from(values).filter((v) => !Number.isNaN(v)).sort();
  return known.length ? known[Math.min(Math.floor(share * known.length), known.length - 1)] : 0;
}

const digits = (value, spread) => value.toFixed(spread >= 20 ? 0 : spread >= 2 ? 1 : 2);
const centimetres = (metres) => {
  const cm = metres * 100;
  return cm >= 1000 ? `${(cm / 100).toFixed(1)} m` : `${cm.toFixed(cm >= 100 ? 0 : 1)} cm`;
};

// Labels of a scale from low to high, left to right.
function ticks({ low, high, label }) {
  return Array.from({ length: TICKS }, (_, i) => label(low + (high - low) * i / (TICKS - 1)));
}

const channelAt = (pattern, x, y) => pattern[y % pattern.length][x % pattern[0].length];

// The mosaic: in the colours of its channels, in grey, or the pixels of one channel alone.
function mosaicPicture(raw, width, height, { pattern, black_dn: black, full_dn: full }, shown) {
  const known = Float32Array.from(raw).sort(), white = Math.max(known[Math.floor(0.995 * known.length)], black + 1);
  return painted(width, height, (pixels) => {
    for (let y = 0, i = 0; y < height; y++) for (let x = 0; x < width; x++, i++) {
      const name = channelAt(pattern, x, y), of = Math.min(Math.max((raw[i] - black) / (white - black), 0), 1);
      const level = 255 * of ** (1 / 2.2), hidden = shown !== "tinted" && shown !== "grey" && shown !== name;
      const tint = shown === "tinted" ? TINT[name] ?? [1, 1, 1] : [1, 1, 1];
      for (let k = 0; k < 3; k++) pixels[i * 4 + k] = hidden ? 0 : level * tint[k];
      if (!hidden && raw[i] >= full) pixels.set([255, 0, 255], i * 4);
      pixels[i * 4 + 3] = 255;
    }
  });
}

