// The worker that unpacks a scene: the other end of viewer/web/atlas_stream.py, which has the notation.
//
// Receives { data: a Blob, level: of the page's description }. Answers { progress } while it works; { grids: { indirection, skipGrid,
// hull } }, bytes of the textures and of the hull's corners; { slot, texels } for each macroblock, which shall be sent back, since
// browsers would keep their memory for a while; and at the end {}. { error } where the file is damaged.
//
// The atlas is an array by slot: Uint32Array of block × block × width voxels, the features beside the rest along x. A macroblock is
// kept as long as others look at it: three layers of the grid, where not all is decoded at once.

const AWAY = 32; // macroblocks that the page may have before more are decoded
const spare = []; // texels that were sent back
let away = 0;
let onReturn = (_) => {};

function texelsOf(slot, atlas, { width, block }) {
  atlas[slot] ??= spare.pop()?.fill(0) ?? new Uint32Array(width * block * block);
  return atlas[slot];
}

// A section of the data, inflated.
async function inflate(data, [offset, length]) {
  const section = data.slice(offset, offset + length);
  return new Uint8Array(await new Response(section.stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer());
}

// The slot of the macroblock at a place in the indirection grid.
function slotAt(at, indirection, { slots }) {
  return indirection[at] + slots[0] * (indirection[at + 1] + slots[1] * indirection[at + 2]);
}

// Macroblocks from `first` on, as many as `bits` are of.
function decodeChunk(bits, differences, first, layout, atlas) {
  const { width, block, features, padding, count } = layout;
  const side = padding ? block : block - 2;
  const parts = features ? 2 : 1;
  const stored = differences.length / (4 * parts);
  const wide = side + 1; // of the scratch volumes: zeros lie before the first voxel along each axis
  const volumes = Array.from({ length: parts }, () => new Uint8Array(4 * wide ** 3));
  const [rgba] = volumes;
  const words = volumes.map((volume) => new Uint32Array(volume.buffer));
  const back = [1, wide, wide * wide];
  const blocks = Math.min(Math.floor((8 * bits.length) / side ** 3), count - first);
  let bit = 0;
  let next = 0;
  for (let number = 0; number < blocks; number++) {
    for (const volume of volumes) volume.fill(0);
    for (let z = 0; z < side; z++)
      for (let y = 0; y < side; y++)
        for (let x = 0; x < side; x++, bit++) {
          if (!((bits[bit >> 3] >> (bit & 7)) & 1)) continue;
          const voxel = x + 1 + wide * (y + 1 + wide * (z + 1));
          let filled = 0;
          for (const step of back) filled += words.some((word) => word[voxel - step]) ? 1 : 0;
          const [i, j, k] = [4 * voxel - 4, 4 * (voxel - wide), 4 * (voxel - wide * wide)];
          const total = rgba[i + 3] + rgba[j + 3] + rgba[k + 3];
          const mean = filled ? Math.floor((2 * total + filled) / (2 * filled)) : 0;
          const alpha = (differences[3 * stored + next] + mean) & 255;
          const green = differences[stored + next];
          for (let part = 0; part < parts; part++) {
            const volume = volumes[part];
            for (let c = 0; c < 4; c++) {
              const sum = volume[i + c] + volume[j + c] + volume[k + c];
              const predicted = total ? Math.min(Math.floor((2 * sum * alpha + total) / (2 * total)), 255) : 0;
              const shared = part === 0 && c !== 1 ? green : 0; // by red and blue; alpha is set below
              volume[4 * voxel + c] = (differences[(4 * part + c) * stored + next] + shared + predicted) & 255;
            }
          }
          rgba[4 * voxel + 3] = alpha;
          next++;
        }
    const texels = texelsOf(first + number, atlas, layout);
    const inner = padding ? 0 : 1 + width * (1 + block);
    for (let part = 0; part < parts; part++)
      for (let z = 0; z < side; z++)
        for (let y = 0; y < side; y++) {
          const from = 1 + wide * (y + 1 + wide * (z + 1));
          const to = part * block + inner + width * (y + block * z);
          for (let x = 0; x < side; x++) texels[to + x] = words[part][from + x];
        }
  }
  if (next !== stored || !blocks) throw new Error();
  return blocks;
}

// Copies the neighbours' voxels around the macroblocks of a layer z of the grid: what scenepack.blocks.restore_padding does.
function restorePadding(atlas, indirection, layout, [nx, ny], z) {
  const { width, block } = layout;
  const entry = (x, y, z) => 4 * (x + nx * (y + ny * z));
  const [last, steps] = [block - 1, [-1, 0, 1]];
  const to = { "-1": 0, 0: 1, 1: last };
  const from = { "-1": last - 1, 0: 1, 1: 1 };
  const lengths = { "-1": 1, 0: block - 2, 1: 1 };
  for (let y = 1; y < ny - 1; y++)
    for (let x = 1; x < nx - 1; x++) {
      if (indirection[entry(x, y, z) + 3]) continue;
      const own = atlas[slotAt(entry(x, y, z), indirection, layout)];
      for (const dz of steps)
        for (const dy of steps)
          for (const dx of steps) {
            const near = entry(x + dx, y + dy, z + dz);
            if (indirection[near + 3] || !(dx || dy || dz)) continue;
            const other = atlas[slotAt(near, indirection, layout)];
            for (let part = 0; part < width; part += block)
              for (let k = 0; k < lengths[dz]; k++)
                for (let j = 0; j < lengths[dy]; j++) {
                  const target = part + to[dx] + width * (to[dy] + j + block * (to[dz] + k));
                  const source = part + from[dx] + width * (from[dy] + j + block * (from[dz] + k));
                  for (let i = 0; i < lengths[dx]; i++) own[target + i] = other[source + i];
                }
          }
    }
}

// Films: what scenepack.codecs.films does, plane by plane, straight into the atlas.

const FRAMES_AHEAD = 8; // that a decoder may have; browsers stop where too many are kept
const DAMAGED = "the scene's data are damaged";
const NO_FILMS = "This browser does not decode AV1 in 4:4:4 exactly. Chrome and Edge do, from disk and over https.";

// each(number, planes): called for every frame, with its planes [bytes, bytes from row to row].
async function playFilm(data, { codec, at, sizes }, codedWidth, codedHeight, each) {
  const settings = { codec, codedWidth, codedHeight, hardwareAcceleration: /** @type {const} */ ("prefer-software") };
  if (!("VideoDecoder" in self) || !(await VideoDecoder.isConfigSupported(settings)).supported) throw new Error(NO_FILMS);
  const samples = await inflate(data, at);
  let [number, from, buffer] = [0, 0, new Uint8Array(0)];
  let copied = Promise.resolve();
  const copy = async (frame) => {
    if (buffer.length < frame.allocationSize()) buffer = new Uint8Array(frame.allocationSize());
    const planes = await frame.copyTo(buffer);
    frame.close();
    each(number++, planes.map(({ offset, stride }) => [buffer.subarray(offset), stride]));
  };
  const decoder = new VideoDecoder({
    output: (frame) => { copied = copied.then(() => copy(frame)); },
    error: () => decoder.dispatchEvent(new Event("dequeue")), // what waits goes on, and fails
  });
  decoder.configure(settings);
  for (const [i, size] of sizes.entries()) {
    const sample = samples.subarray(from, from + size);
    decoder.decode(new EncodedVideoChunk({ type: i ? "delta" : "key", timestamp: i, data: sample }));
    from += size;
    while (decoder.decodeQueueSize > FRAMES_AHEAD) await new Promise((resolve) => decoder.addEventListener("dequeue", resolve, { once: true }));
    await copied;
  }
  await decoder.flush();
  await copied;
  if (number !== sizes.length) throw new Error();
  decoder.close();
}

const clamped = (v) => Math.min(Math.max(v, 0), 255);

// Calls voxel(pixel of the plane, bytes of its macroblock, which of them) for all voxels of a piece's plane z that lie in macroblocks.
function inPlane({ corner, shape: [width, height] }, z, layout, indirection, [nx, ny], atlas, voxel) {
  const { width: across, block } = layout;
  const side = block - 2;
  for (let by = 0; by < height / side; by++)
    for (let bx = 0; bx < width / side; bx++) {
      const at = 4 * (corner[0] + bx + 1 + nx * (corner[1] + by + 1 + ny * (corner[2] + Math.floor(z / side) + 1)));
      if (indirection[at + 3]) continue;
      const texels = new Uint8Array(texelsOf(slotAt(at, indirection, layout), atlas, layout).buffer);
      const origin = 1 + across * (1 + block * (1 + (z % side)));
      for (let y = 0; y < side; y++)
        for (let x = 0; x < side; x++) voxel(bx * side + x, by * side + y, texels, 4 * (origin + x + across * y));
    }
}

async function decodePiece(data, piece, layout, indirection, grid, atlas, onFrame) {
  const { shape: [width, height], films } = piece;
  const occupied = await inflate(data, piece.occupied);
  const cubes = [width, height].map((side) => (side + 1) >> 1); // a byte for each 2³ voxels
  const isOccupied = (x, y, z) =>
    (occupied[(x >> 1) + cubes[0] * ((y >> 1) + cubes[1] * (z >> 1))] >> (7 - (x & 1) - 2 * (y & 1) - 4 * (z & 1))) & 1;
  const coded = (side) => 16 * Math.ceil(side / 16);
  const second = 4 * layout.block; // from a voxel's rgba to its features
  const times = (value, alpha) => Math.floor((value * alpha + 127) / 255);
  const plane = (z, voxel) => { inPlane(piece, z, layout, indirection, grid, atlas, voxel); onFrame(); };
  const grey = (write) => (z, [[luma, row]]) =>
    plane(z, (x, y, texels, to) => write(luma[x + row * y], texels, to, x, y, z));
  // BT.709, all 256 levels, in the whole numbers that libyuv computes with
  const colour = (part) => (z, planes) => {
    if (planes.length !== 3) throw new Error(NO_FILMS);
    const [[luma, row], [blues, row2], [reds, row3]] = planes;
    plane(z, (x, y, texels, to) => {
      const alpha = texels[to + 3];
      if (!alpha) return;
      const light = (luma[x + row * y] * 257 * 16320) >> 16;
      const [blue, red] = [blues[x + row2 * y] - 128, reds[x + row3 * y] - 128];
      texels[to + part] = times(clamped((light + 101 * red + 32) >> 6), alpha);
      texels[to + part + 1] = times(clamped((light - 12 * blue - 30 * red + 32) >> 6), alpha);
      texels[to + part + 2] = times(clamped((light + 119 * blue + 32) >> 6), alpha);
    });
  };
  const steps = [
    grey((value, texels, to, x, y, z) => { texels[to + 3] = isOccupied(x, y, z) ? Math.max(value, 1) : 0; }),
    colour(0),
    colour(second),
    grey((value, texels, to) => { texels[to + second + 3] = times(value, texels[to + 3]); }),
  ];
  for (const [i, film] of films.entries()) await playFilm(data, film, coded(width), coded(height), steps[i]);
}

// Words from all their low bytes, then all their high bytes.
function interleaved(halves) {
  const [words, count] = [new Uint8Array(halves.length), halves.length / 2];
  for (let i = 0; i < count; i++) [words[2 * i], words[2 * i + 1]] = [halves[i], halves[count + i]];
  return words;
}

// How many macroblocks lie before each layer z of the grid, and in all.
function slotsBefore(indirection, [nx, ny, nz]) {
  const before = [0];
  for (let z = 0; z < nz; z++) {
    const layer = indirection.subarray(4 * nx * ny * z, 4 * nx * ny * (z + 1));
    before.push(before[z] + layer.filter((value, i) => i % 4 === 3 && !value).length);
  }
  return before;
}

async function decode({ data, level }) {
  const layout = { ...level.atlas, width: level.atlas.block * (level.atlas.features ? 2 : 1) };
  const { padding, count } = layout;
  const grid = level.indirection.size;
  const indirection = await inflate(data, level.indirection.at);
  const skipGrid = interleaved(await inflate(data, level.skip_grid.at));
  const hull = level.hull ? await inflate(data, level.hull) : null;
  postMessage({ grids: { indirection, skipGrid, hull } });
  const before = slotsBefore(indirection, grid);
  const atlas = [];
  let [layer, sent] = [1, 0]; // the first whose padding is missing; macroblocks that are sent
  // Sends the macroblocks that are complete and needed no more now that the first `decoded` are there.
  const send = (decoded) => {
    for (; !padding && layer < grid[2] - 1 && decoded >= before[layer + 2]; layer++)
      restorePadding(atlas, indirection, layout, grid, layer);
    const complete = padding || decoded === count ? decoded : before[layer - 1];
    for (; sent < complete; sent++) {
      const texels = new Uint8Array(atlas[sent].buffer);
      postMessage({ slot: sent, texels }, { transfer: [texels.buffer] });
      atlas[sent] = null;
      away++;
    }
  };
  let done = 0;
  if (layout.pieces) {
    const frames = layout.pieces.flatMap(({ films }) => films.map(({ sizes }) => sizes.length)).reduce((sum, n) => sum + n, 0);
    const report = () => { if (!(++done % 32)) postMessage({ progress: done / frames }); };
    for (const piece of layout.pieces) await decodePiece(data, piece, layout, indirection, grid, atlas, report);
    send(count);
  } else {
    for (const [bits, differences] of layout.chunks) {
      done += decodeChunk(await inflate(data, bits), await inflate(data, differences), done, layout, atlas);
      send(done);
      postMessage({ progress: done / count });
      while (away > AWAY) await new Promise((resolve) => { onReturn = resolve; });
    }
    if (done !== count) throw new Error();
  }
  postMessage({});
}

// Browsers have words of their own for what cannot be inflated or played.
function wordsFor(error) {
  if (error instanceof RangeError || error.name === "NotReadableError") return "there is not enough memory for this scene";
  return error.message === NO_FILMS ? NO_FILMS : DAMAGED;
}

self.onmessage = ({ data }) => {
  if (data.level) return decode(data).catch((error) => postMessage({ error: wordsFor(error) }));
  spare.push(new Uint32Array(data.buffer));
  away--;
  onReturn(null);
};
