//! Skinning evaluated straight from a GLB's bytes, sharing no code with the reader it judges: vertices
//! of mesh 0 under skin 0, animation 0 with linear keys.

use codec_core::Gaussian;
use serde_json::Value;

type Matrix = [[f64; 4]; 4];
/// Translation, rotation (xyzw), scale; or a matrix instead.
type Local = ([f64; 3], [f64; 4], [f64; 3], Option<Matrix>);

struct File<'a> {
    root: Value,
    blob: &'a [u8],
}

/// Triangles of the skinned mesh at `time` seconds after the first key.
pub fn skinned(bytes: &[u8], time: f64) -> Vec<[[f64; 3]; 3]> {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let length = word(12);
    let root: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let file = File { root, blob: &bytes[28 + length..] };
    let primitive = &file.root["meshes"][0]["primitives"][0];
    let attribute = |name: &str| file.values(&primitive["attributes"][name]);
    let (positions, joints, weights) = (attribute("POSITION"), attribute("JOINTS_0"), attribute("WEIGHTS_0"));

    let nodes = file.root["nodes"].as_array().unwrap();
    let mut local: Vec<Local> = nodes.iter().map(local).collect();
    let animation = &file.root["animations"][0];
    let channels = animation["channels"].as_array().unwrap();
    let sampler = |c: &Value| &animation["samplers"][c["sampler"].as_u64().unwrap() as usize];
    let start = channels.iter().map(|c| file.values(&sampler(c)["input"])[0]).fold(f64::INFINITY, f64::min);
    for channel in channels {
        let (keys, values) =
            (file.values(&sampler(channel)["input"]), file.values(&sampler(channel)["output"]));
        let node = channel["target"]["node"].as_u64().unwrap() as usize;
        let path = channel["target"]["path"].as_str().unwrap();
        let width = if path == "rotation" { 4 } else { 3 };
        let t = (start + time).clamp(keys[0], *keys.last().unwrap());
        let b = keys.iter().position(|&k| k >= t).unwrap().max(1).min(keys.len() - 1);
        let s = if keys.len() == 1 { 0.0 } else { (t - keys[b - 1]) / (keys[b] - keys[b - 1]) };
        let at = |k: usize| &values[k * width..(k + 1) * width];
        let v = interpolated(at(b.saturating_sub(1).min(keys.len() - 1)), at(b), s, width == 4);
        match path {
            "translation" => local[node].0 = [v[0], v[1], v[2]],
            "rotation" => local[node].1 = [v[0], v[1], v[2], v[3]],
            _ => local[node].2 = [v[0], v[1], v[2]],
        }
    }

    let mut parent = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for child in node["children"].as_array().into_iter().flatten() {
            parent[child.as_u64().unwrap() as usize] = Some(i);
        }
    }
    let world = |node: usize| {
        let mut matrix = composed(&local[node]);
        let mut above = parent[node];
        while let Some(p) = above {
            matrix = product(&composed(&local[p]), &matrix);
            above = parent[p];
        }
        matrix
    };
    let skin = &file.root["skins"][0];
    let inverses = file.values(&skin["inverseBindMatrices"]);
    let bones: Vec<Matrix> = skin["joints"]
        .as_array()
        .unwrap()
        .iter()
        .enumerate()
        .map(|(j, node)| {
            let inverse =
                std::array::from_fn(|row| std::array::from_fn(|column| inverses[j * 16 + column * 4 + row]));
            product(&world(node.as_u64().unwrap() as usize), &inverse)
        })
        .collect();
    let vertices: Vec<[f64; 3]> = (0..positions.len() / 3)
        .map(|v| {
            let p = [positions[3 * v], positions[3 * v + 1], positions[3 * v + 2], 1.0];
            // Some files cut influences beyond four without making the rest sum to one again.
            let sum: f64 = weights[4 * v..4 * v + 4].iter().sum();
            std::array::from_fn(|row| {
                (0..4)
                    .map(|k| {
                        let bone = &bones[joints[4 * v + k] as usize];
                        weights[4 * v + k] / sum * (0..4).map(|c| bone[row][c] * p[c]).sum::<f64>()
                    })
                    .sum()
            })
        })
        .collect();
    let indices: Vec<usize> = match &primitive["indices"] {
        Value::Null => (0..vertices.len()).collect(),
        some => file.values(some).iter().map(|&v| v as usize).collect(),
    };
    indices.chunks_exact(3).map(|t| [vertices[t[0]], vertices[t[1]], vertices[t[2]]]).collect()
}

/// The largest distance from a Gaussian's centre to the nearest triangle (up to 500 of them are tried).
pub fn furthest_from_triangles(gaussians: &[Gaussian], triangles: &[[[f64; 3]; 3]]) -> f64 {
    let step = gaussians.len().div_ceil(500);
    gaussians
        .iter()
        .step_by(step)
        .map(|g| {
            let p = g.position.map(f64::from);
            triangles.iter().map(|t| distance(p, t)).fold(f64::INFINITY, f64::min)
        })
        .fold(0.0, f64::max)
}

impl File<'_> {
    fn values(&self, accessor: &Value) -> Vec<f64> {
        let accessor = &self.root["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &self.root["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let number = |v: &Value, key: &str| v[key].as_u64().unwrap_or(0) as usize;
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let kind = number(accessor, "componentType");
        let size = match kind {
            5121 => 1,
            5123 => 2,
            _ => 4,
        };
        let stride = view["byteStride"].as_u64().map_or(width * size, |s| s as usize);
        let start = number(view, "byteOffset") + number(accessor, "byteOffset");
        let mut out = Vec::new();
        for element in 0..number(accessor, "count") {
            for c in 0..width {
                let at = start + element * stride + c * size;
                let raw = &self.blob[at..at + size];
                out.push(match kind {
                    5121 => f64::from(raw[0]),
                    5123 => f64::from(u16::from_le_bytes([raw[0], raw[1]])),
                    5125 => f64::from(u32::from_le_bytes(raw.try_into().unwrap())),
                    _ => f64::from(f32::from_le_bytes(raw.try_into().unwrap())),
                });
            }
        }
        out
    }
}

fn local(node: &Value) -> Local {
    let list = |key: &str| -> Option<Vec<f64>> {
        Some(node[key].as_array()?.iter().map(|v| v.as_f64().unwrap()).collect())
    };
    let three = |key: &str, default: f64| list(key).map_or([default; 3], |v| [v[0], v[1], v[2]]);
    let rotation = list("rotation").map_or([0.0, 0.0, 0.0, 1.0], |v| [v[0], v[1], v[2], v[3]]);
    let matrix = list("matrix").map(|m| std::array::from_fn(|row| std::array::from_fn(|c| m[c * 4 + row])));
    (three("translation", 0.0), rotation, three("scale", 1.0), matrix)
}

fn interpolated(a: &[f64], b: &[f64], s: f64, spherical: bool) -> Vec<f64> {
    if !spherical {
        return a.iter().zip(b).map(|(a, b)| a + (b - a) * s).collect();
    }
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    let (sign, dot) = (dot.signum(), dot.abs().min(1.0));
    let theta = dot.acos();
    let (wa, wb) = if theta < 1e-4 {
        (1.0 - s, s)
    } else {
        (((1.0 - s) * theta).sin() / theta.sin(), (s * theta).sin() / theta.sin())
    };
    a.iter().zip(b).map(|(a, b)| wa * a + wb * sign * b).collect()
}

fn composed((t, [x, y, z, w], s, matrix): &Local) -> Matrix {
    if let Some(matrix) = matrix {
        return *matrix;
    }
    let l = (x * x + y * y + z * z + w * w).sqrt();
    let [x, y, z, w] = [x / l, y / l, z / l, w / l];
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let row = |i: usize| [r[i][0] * s[0], r[i][1] * s[1], r[i][2] * s[2], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Distance from a point to a triangle: to its plane where the foot is inside, else to an edge.
fn distance(p: [f64; 3], [a, b, c]: &[[f64; 3]; 3]) -> f64 {
    let sub = |x: &[f64; 3], y: &[f64; 3]| [x[0] - y[0], x[1] - y[1], x[2] - y[2]];
    let dot = |x: [f64; 3], y: [f64; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(&p, a));
    let (d00, d01, d11) = (dot(ab, ab), dot(ab, ac), dot(ac, ac));
    let (d20, d21) = (dot(ap, ab), dot(ap, ac));
    let denominator = d00 * d11 - d01 * d01;
    let (v, w) = ((d11 * d20 - d01 * d21) / denominator, (d00 * d21 - d01 * d20) / denominator);
    if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
        let off = [0, 1, 2].map(|i| ap[i] - v * ab[i] - w * ac[i]);
        return dot(off, off).sqrt();
    }
    let edge = |from: &[f64; 3], to: &[f64; 3]| {
        let (along, offset) = (sub(to, from), sub(&p, from));
        let t = (dot(offset, along) / dot(along, along).max(1e-30)).clamp(0.0, 1.0);
        let off = [0, 1, 2].map(|i| offset[i] - t * along[i]);
        dot(off, off).sqrt()
    };
    edge(a, b).min(edge(b, c)).min(edge(c, a))
}
