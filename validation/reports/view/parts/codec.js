// Data of the page: pictures and packed numbers, decoded when they are first needed.

const bytesOf = (text) => {
  const binary = atob(text), bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
};

const decodePicture = (text) =>
  createImageBitmap(new Blob([bytesOf(text)], { type: "image/webp" }),
    { colorSpaceConversion: "none", premultiplyAlpha: "none" });

// Integers [h, w]: zlib, high bytes before low bytes, differences along rows.
async function decodeNumbers(text, width, height) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = width * height, numbers = new Uint16Array(count);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0, last = 0; x < width; x++, i++) {
      last = (last + (planes[i] << 8) + planes[count + i]) & 0xffff;
      numbers[i] = last;
    }
  }
  return numbers;
}

// A map as floats, NaN where there is no value.
async function decodeMap(map, width, height) {
  const numbers = await decodeNumbers(map.data, width, height), values = new Float32Array(numbers.length);
  for (let i = 0; i < numbers.length; i++) values[i] = numbers[i] ? map.low + (numbers[i] - 1) * map.step : NaN;
  return values;
}

// Keeps the latest results of a function of a key; older ones are made again.
function remembered(most, make) {
  const kept = new Map();
  return (key, ...rest) => {
    const found = kept.has(key) ? kept.get(key) : make(key, ...rest);
    kept.delete(key);
    kept.set(key, found);
    if (kept.size > most) kept.delete(kept.keys().next().value);
    return found;
  };
}

