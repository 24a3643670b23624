// Makes the files of this folder with the tools that others compress glTF with:
//
//   npm install meshoptimizer@1.3.0 gltfpack@1.3.0 @gltf-transform/cli@4.5.1 && node make.mjs
//
// `streams.json` has buffer views as meshoptimizer's encoder writes them, and what its decoder makes of them.
// `splats.glb` and `packed-splats.glb` are the same Gaussians, plain and with every view compressed.
// `packed-strip.glb` is the mesh of the fuzz corpus through gltfpack, `draco-*.glb` through glTF-Transform.

import { execFileSync } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { MeshoptDecoder, MeshoptEncoder } from "meshoptimizer";

await MeshoptEncoder.ready;
await MeshoptDecoder.ready;

let state = 1;
/// A number in 0..1, the same on every run.
const random = () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
};
const bytesOf = (array) => new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
const hex = (bytes) => Buffer.from(bytes).toString("hex");

/// A view's stream, by meshoptimizer.
const encoded = (bytes, count, stride, mode, version) =>
    MeshoptEncoder.encodeGltfBuffer(bytes, count, stride, mode, version);

const streams = [];
const add = (name, source, count, stride, mode, filter, version) => {
    const stream = encoded(source, count, stride, mode, version);
    const unfolded = new Uint8Array(count * stride);
    MeshoptDecoder.decodeGltfBuffer(unfolded, count, stride, stream, mode, filter);
    streams.push({ name, count, stride, mode, filter: filter ?? "NONE", stream: hex(stream), unfolded: hex(unfolded) });
};

// Attributes: smooth, random and constant channels, widths that need several blocks.
for (const version of [0, 1]) {
    for (const [count, stride] of [[1, 4], [37, 12], [300, 4], [33, 256], [33, 16]]) {
        const source = new Uint8Array(count * stride);
        for (let i = 0; i < count; i++) {
            for (let k = 0; k < stride; k++) {
                const kinds = [i, i * i >> 3, random() * 256, 7, random() < 0.1 ? 200 : 3, i >> 2];
                source[i * stride + k] = kinds[(k >> 2) % kinds.length] + (k & 3);
            }
        }
        add(`attributes ${version}: ${count} of ${stride}`, source, count, stride, "ATTRIBUTES", undefined, version);
    }
    // Words that grow across bytes, floats that share their upper bits.
    const words = Uint16Array.from({ length: 160 }, (_, i) => 250 * i + random() * 9);
    add(`words ${version}`, bytesOf(words), 40, 8, "ATTRIBUTES", undefined, version);
    const floats = Float32Array.from({ length: 120 }, (_, i) => Math.sin(i / 9) + random() * 1e-3);
    add(`floats ${version}`, bytesOf(floats), 40, 12, "ATTRIBUTES", undefined, version);
}

// Filters.
const unit = (width) => {
    const v = Array.from({ length: width }, () => random() * 2 - 1);
    const length = Math.hypot(...v);
    return v.map((x) => x / length);
};
const vectors = Float32Array.from(Array.from({ length: 40 }, () => [...unit(3), 1]).flat());
const turns = Float32Array.from(Array.from({ length: 40 }, () => unit(4)).flat());
const lengths = Float32Array.from({ length: 120 }, () => (random() - 0.5) * 2 ** (random() * 40 - 20));
const colours = Float32Array.from({ length: 160 }, random);
add("octahedral 4", MeshoptEncoder.encodeFilterOct(vectors, 40, 4, 7), 40, 4, "ATTRIBUTES", "OCTAHEDRAL", 0);
add("octahedral 8", MeshoptEncoder.encodeFilterOct(vectors, 40, 8, 12), 40, 8, "ATTRIBUTES", "OCTAHEDRAL", 1);
add("quaternion", MeshoptEncoder.encodeFilterQuat(turns, 40, 8, 12), 40, 8, "ATTRIBUTES", "QUATERNION", 0);
add("exponential", MeshoptEncoder.encodeFilterExp(lengths, 40, 12, 15, "Separate"), 40, 12, "ATTRIBUTES", "EXPONENTIAL", 0);
add("colour 4", MeshoptEncoder.encodeFilterColor(colours, 40, 4, 8), 40, 4, "ATTRIBUTES", "COLOR", 1);
add("colour 8", MeshoptEncoder.encodeFilterColor(colours, 40, 8, 12), 40, 8, "ATTRIBUTES", "COLOR", 1);

// Triangles of a grid, with some that belong to nothing, and a strip.
const side = 9;
const triangles = [];
for (let y = 0; y + 1 < side; y++) {
    for (let x = 0; x + 1 < side; x++) {
        const a = y * side + x;
        triangles.push(a, a + 1, a + side, a + 1, a + side + 1, a + side);
        if (random() < 0.2) triangles.push(...Array.from({ length: 3 }, () => (random() * 60000) | 0));
    }
}
for (const stride of [2, 4]) {
    const indices = bytesOf(stride === 2 ? Uint16Array.from(triangles) : Uint32Array.from(triangles));
    add(`triangles ${stride}`, indices, triangles.length, stride, "TRIANGLES");
    add(`indices ${stride}`, indices, triangles.length, stride, "INDICES");
}
writeFileSync("streams.json", `[\n${streams.map((s) => JSON.stringify(s)).join(",\n")}\n]\n`);

/// A GLB of these attributes, each [name, values as a typed array, width, type, extra fields of the accessor].
function glb(attributes, count, compress) {
    const chunks = [], bufferViews = [], accessors = [], names = {};
    let length = 0, unfoldedLength = 0;
    for (const { name, data, stride, accessor, filter, version } of attributes) {
        const bytes = compress ? encoded(data, count, stride, "ATTRIBUTES", version) : data;
        const place = { buffer: 0, byteOffset: length, byteLength: bytes.length };
        chunks.push(bytes, new Uint8Array(-bytes.length & 3));
        length += bytes.length + (-bytes.length & 3);
        const extension = version === 0 ? "EXT_meshopt_compression" : "KHR_meshopt_compression";
        const described = { ...place, byteStride: stride, mode: "ATTRIBUTES", count, ...(filter && { filter }) };
        bufferViews.push(compress
            ? { buffer: 1, byteOffset: unfoldedLength, byteLength: count * stride, byteStride: stride,
                extensions: { [extension]: described } }
            : { ...place, byteStride: stride });
        unfoldedLength += count * stride;
        names[name] = accessors.length;
        accessors.push({ bufferView: bufferViews.length - 1, count, ...accessor });
    }
    const extensionsUsed = ["KHR_gaussian_splatting"];
    if (compress) extensionsUsed.push("KHR_mesh_quantization", "EXT_meshopt_compression", "KHR_meshopt_compression");
    const buffers = [{ byteLength: length }];
    if (compress) buffers.push({ byteLength: unfoldedLength });
    const text = Buffer.from(JSON.stringify({
        asset: { version: "2.0" }, extensionsUsed, extensionsRequired: extensionsUsed,
        scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }],
        meshes: [{ primitives: [{ mode: 0, attributes: names, extensions: { KHR_gaussian_splatting: {
            kernel: "ellipse", colorSpace: "srgb_rec709_display" } } }] }],
        accessors, bufferViews, buffers,
    }));
    const padded = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
    const word = (value) => Buffer.from(Uint32Array.of(value).buffer);
    return Buffer.concat([
        Buffer.from("glTF"), word(2), word(28 + padded.length + length),
        word(padded.length), Buffer.from("JSON"), padded, word(length), Buffer.from("BIN\0"), ...chunks,
    ]);
}

const count = 90;
const float = (type) => ({ componentType: 5126, type });
const several = (width, value) => Float32Array.from({ length: count * width }, (_, i) => value(i, i % width));
const exponential = (values, width) =>
    MeshoptEncoder.encodeFilterExp(values, count, 4 * width, 15, "SharedVector");
const positions = several(3, (i, c) => Math.sin(i / 7 + c) * 3);
const scales = several(3, () => 2 ** (-3 - 3 * random()));
const rotations = Float32Array.from(Array.from({ length: count }, () => unit(4)).flat());
const opacities = several(1, () => 0.05 + 0.9 * random());
const splat = (name) => `KHR_gaussian_splatting:${name}`;
const bands = Array.from({ length: 4 }, () => several(3, () => random() - 0.5));
const bandName = (band) => splat(band === 0 ? "SH_DEGREE_0_COEF_0" : `SH_DEGREE_1_COEF_${band - 1}`);
const plain = (name, values, width, type) => ({ name, data: bytesOf(values), stride: 4 * width, accessor: float(type) });
writeFileSync("splats.glb", glb([
    { ...plain("POSITION", positions, 3, "VEC3"), accessor: { ...float("VEC3"), min: [-3, -3, -3], max: [3, 3, 3] } },
    plain(splat("SCALE"), scales, 3, "VEC3"),
    plain(splat("ROTATION"), rotations, 4, "VEC4"),
    plain(splat("OPACITY"), opacities, 1, "SCALAR"),
    ...bands.map((values, band) => plain(bandName(band), values, 3, "VEC3")),
], count, false));
const bytes = new Uint8Array(count * 4);
opacities.forEach((opacity, i) => { bytes[4 * i] = Math.round(opacity * 255); });
writeFileSync("packed-splats.glb", glb([
    { name: "POSITION", data: bytesOf(positions), stride: 12, version: 1,
        accessor: { ...float("VEC3"), min: [-3, -3, -3], max: [3, 3, 3] } },
    { name: splat("SCALE"), data: exponential(scales, 3), stride: 12, filter: "EXPONENTIAL", version: 0,
        accessor: float("VEC3") },
    { name: splat("ROTATION"), data: MeshoptEncoder.encodeFilterQuat(rotations, count, 8, 14), stride: 8,
        filter: "QUATERNION", version: 1, accessor: { componentType: 5122, normalized: true, type: "VEC4" } },
    { name: splat("OPACITY"), data: bytes, stride: 4, version: 0,
        accessor: { componentType: 5121, normalized: true, type: "SCALAR" } },
    ...bands.map((values, band) => ({ name: bandName(band), data: exponential(values, 3), stride: 12,
        filter: "EXPONENTIAL", version: 1, accessor: float("VEC3") })),
], count, true));

const mesh = "../../../fuzz/corpus/gltf/strip.glb";
const run = (program, ...args) => execFileSync(`${process.cwd()}/node_modules/.bin/${program}`, args);
run("gltfpack", "-i", mesh, "-o", "packed-strip.glb", "-cz", "-ce", "khr", "-kn");
for (const method of ["edgebreaker", "sequential"]) {
    run("gltf-transform", "draco", mesh, `draco-${method}.glb`, "--method", method);
}
