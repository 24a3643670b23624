// Compares what readers of others find in files that dgs wrote with the PLY that these were made of, Gaussian by
// Gaussian: Niantic's reader of SPZ (npm: @spz-loader/core, compiled from it) and gsplat.js (npm: gsplat).
//
//   node peer-readers.mjs SOURCE.ply OURS.spz OURS.ply OURS.splat     beside node_modules with both
//
// Ends with 1 where one of them differs by more than its format does.
import { readFileSync } from "node:fs";

const [source, ...files] = process.argv.slice(2);
// The reader of SPZ takes a browser for granted.
process.type = "renderer";
globalThis.window = globalThis;

const bytes = (path) => {
  const { buffer, byteOffset, length } = readFileSync(path);
  return buffer.slice(byteOffset, byteOffset + length);
};

// Positions, sizes, rotations (wxyz) and opacities, as gsplat.js reads them.
async function byGsplat(path) {
  const { Loader, PLYLoader, Scene } = await import("gsplat");
  const reader = path.endsWith(".ply") ? PLYLoader : Loader;
  const { data } = reader.LoadFromArrayBuffer(bytes(path), new Scene());
  const { vertexCount: count, positions, scales, rotations, colors } = data;
  return { count, positions, scales, rotations, opacities: Array.from({ length: count }, (_, i) => colors[4 * i + 3] / 255) };
}

// The same as Niantic's reader finds them, turned from RUB to the axes of PLY: half round about x.
async function byNiantic(path) {
  const { loadSpz } = await import("@spz-loader/core");
  const { numPoints: count, positions, scales, rotations, alphas } = await loadSpz(new Uint8Array(bytes(path)));
  const turned = positions.map((v, k) => (k % 3 === 0 ? v : -v));
  const quaternions = new Float32Array(4 * count);
  for (let i = 0; i < count; i++) {
    const [x, y, z, w] = rotations.subarray(4 * i, 4 * i + 4);
    quaternions.set([-x, w, -z, y], 4 * i);
  }
  return { count, positions: turned, scales, rotations: quaternions, opacities: alphas };
}

function largest(count, of) {
  let most = 0;
  for (let i = 0; i < count; i++) most = Math.max(most, of(i));
  return most;
}

// The largest differences: of places (scene units), sizes (factor), rotations (1 - |cosine|), opacities.
function differences(found, wanted) {
  const { count } = wanted;
  const apart = (name) => largest(3 * count, (k) => Math.abs(found[name][k] - wanted[name][k]));
  // Nothing is seen of Gaussians smaller than this, which formats round.
  const size = (v) => Math.max(v, 1e-4);
  const factor = largest(3 * count, (k) => Math.abs(Math.log(size(found.scales[k]) / size(wanted.scales[k]))));
  const turn = largest(count, (i) => {
    const [a, b] = [found.rotations, wanted.rotations].map((q) => q.subarray(4 * i, 4 * i + 4));
    const dot = a.reduce((sum, v, k) => sum + v * b[k], 0) / (Math.hypot(...a) * Math.hypot(...b));
    return 1 - Math.abs(dot);
  });
  const opacity = largest(count, (i) => Math.abs(found.opacities[i] - wanted.opacities[i]));
  return [apart("positions"), Math.exp(factor) - 1, turn, opacity];
}

// What a format may round by: fixed point of 12 bits, sixteenths of a power of e, 8 bits.
const MOST = { spz: [3e-4, 0.04, 2e-3, 0.006], ply: [1e-6, 1e-4, 1e-3, 0.005], splat: [1e-6, 1e-4, 1e-3, 0.005] };
const wanted = await byGsplat(source);
let good = true;
for (const path of files) {
  const ending = path.split(".").pop();
  const found = await (ending === "spz" ? byNiantic(path) : byGsplat(path));
  const values = found.count === wanted.count ? differences(found, wanted) : [];
  const fits = values.length > 0 && values.every((value, k) => value <= MOST[ending][k]);
  const reader = ending === "spz" ? "Niantic's reader" : "gsplat.js";
  const said = values.map((value, k) => `${["place", "size", "turn", "opacity"][k]} ${value.toPrecision(2)}`).join(", ");
  console.log(`${ending}: dgs wrote, ${reader} read: ${found.count} of ${wanted.count}; at most ${said}${fits ? "" : "  DIFFERS"}`);
  good &&= fits;
}
process.exit(good ? 0 : 1);
