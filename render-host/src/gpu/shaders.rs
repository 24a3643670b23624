//! Every shader is listed here; tests check each text, its structs, constants and bindings against Rust.

use super::{
    adjoint::{self, blend_buffers, structure},
    lists, renderer,
    source::Source,
    states, tiles,
};

/// All shaders. Add yours here, and its structs to `structs` in the tests below.
pub static ALL: &[&Source] = &[
    &lists::PROJECT,
    &lists::PLAN,
    &lists::SORT,
    &lists::BIN,
    &lists::STARTS,
    &renderer::BLEND,
    &renderer::WORLDS,
    &tiles::RANK,
    &states::SHARED_LISTS,
    &states::COLUMN_SUMS,
    &blend_buffers::BLEND_BACK,
    &structure::FRAMEBUFFER,
    &structure::STRUCTURE,
    &adjoint::PROJECT_BACK,
];

#[cfg(test)]
mod tests {
    use std::mem::offset_of;

    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::{
        super::{
            adjoint::structure::{STRUCTURE, Window},
            layout::{CONSTANTS, Frame, LOSS_CONSTANTS, Splat},
            lists::PROJECT,
            source::{Bind, LAYOUT},
            states::{Batch, Entry, Table},
        },
        *,
    };

    /// Workgroup memory that every WebGPU device has, bytes.
    const WORKGROUP_BYTES: u32 = 16_384;
    /// Storage buffers that every WebGPU device binds.
    const STORAGE_BUFFERS: usize = 8;

    /// A struct: WGSL name, bytes, name and offset of every member.
    type Layout = (&'static str, usize, Vec<(&'static str, usize)>);

    macro_rules! layout {
        ($ty:ty: $($field:ident),*) => {
            (stringify!($ty), size_of::<$ty>(), vec![$((stringify!($field), offset_of!($ty, $field))),*])
        };
    }

    /// The Rust side of every struct.
    fn structs() -> Vec<Layout> {
        vec![
            layout!(Splat: mean, columns, rows, root, log2_alpha, colour, group),
            layout!(Frame: view, view_low, focal, principal, slope, background, size, near, near_low,
                low_pass, alpha_cutoff, cutoff, log2_cutoff, alpha_max, stop, gaussians, degree, flags, zero,
                capacity, worlds, world_words, spare),
            layout!(Batch: groups, words, worlds, quads, scale, columns, first, past),
            layout!(Entry: splat, blocks),
            layout!(Table: rows, columns, unused),
            layout!(Window: along, down, centres, scale, unused),
        ]
    }

    fn parse(text: &str) -> Result<naga::Module, String> {
        let module = naga::front::wgsl::parse_str(text).map_err(|e| e.emit_to_string(text))?;
        // No capability beyond base WebGPU.
        Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .map_err(|e| e.emit_to_string(text))?;
        Ok(module)
    }

    /// What is wrong with `source`, whose text is `text`.
    fn faults(source: &Source, text: &str, structs: &[Layout]) -> Vec<String> {
        let module = match parse(text) {
            Ok(module) => module,
            Err(message) => return vec![message],
        };
        let mut found = Vec::new();
        for (_, ty) in module.types.iter() {
            let naga::TypeInner::Struct { members, span } = &ty.inner else { continue };
            let Some(name) = &ty.name else { continue };
            let is = |l: &&Layout| l.0 == name.as_str();
            // Structs that never leave the shader are its own affair.
            let Some((_, size, fields)) = structs.iter().find(is) else { continue };
            let there: Vec<(&str, usize)> =
                members.iter().map(|m| (m.name.as_deref().unwrap_or(""), m.offset as usize)).collect();
            if there != *fields || *span as usize != *size {
                found.push(format!("struct {name}: WGSL {span} {there:?}, Rust {size} {fields:?}"));
            }
        }
        for (_, constant) in module.constants.iter() {
            let Some(name) = &constant.name else { continue };
            let mut shared = CONSTANTS.iter().chain(LOSS_CONSTANTS);
            let Some(&(_, expected)) = shared.find(|c| c.0 == name.as_str()) else { continue };
            let naga::Expression::Literal(literal) = module.global_expressions[constant.init] else {
                found.push(format!("constant {name} is no literal"));
                continue;
            };
            let value = match literal {
                naga::Literal::U32(v) => f64::from(v),
                naga::Literal::F32(v) => f64::from(v),
                other => {
                    found.push(format!("constant {name} is {other:?}"));
                    continue;
                }
            };
            if value != expected {
                found.push(format!("constant {name}: WGSL {value}, Rust {expected}"));
            }
        }
        let mut there = Vec::new();
        let mut workgroup = 0;
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        for (_, global) in module.global_variables.iter() {
            if global.space == naga::AddressSpace::WorkGroup {
                workgroup += layouter[global.ty].size;
            }
            let Some(binding) = &global.binding else { continue };
            let bind = match global.space {
                naga::AddressSpace::Uniform => Bind::Uniform,
                naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => {
                    Bind::Write
                }
                _ => Bind::Read,
            };
            there.push((binding.group, binding.binding, global.name.clone().unwrap_or_default(), bind));
        }
        there.sort_by_key(|b| (b.0, b.1));
        let expected: Vec<_> =
            (0u32..).zip(source.bindings).map(|(i, &(name, bind))| (0, i, name.to_owned(), bind)).collect();
        if there != expected {
            found.push(format!("bindings: WGSL {there:?}, Rust {expected:?}"));
        }
        if expected.iter().filter(|b| b.3 != Bind::Uniform).count() > STORAGE_BUFFERS {
            found.push("more storage buffers than base WebGPU binds".into());
        }
        if workgroup > WORKGROUP_BYTES {
            found.push(format!("{workgroup} bytes of workgroup memory"));
        }
        for entry in &module.entry_points {
            if entry.workgroup_size.iter().product::<u32>() > 256 {
                found.push(format!("{}: workgroup of {:?}", entry.name, entry.workgroup_size));
            }
        }
        found.iter_mut().for_each(|f| f.insert_str(0, &format!("{}: ", source.name)));
        found
    }

    #[test]
    fn every_shader_validates_for_browsers_and_matches_rust() {
        let structs = structs();
        let found: Vec<String> = ALL.iter().flat_map(|s| faults(s, &s.text(), &structs)).collect();
        assert!(found.is_empty(), "{}", found.join("\n"));
    }

    #[test]
    fn every_constant_of_the_loss_is_in_its_text() {
        let module = parse(&STRUCTURE.text()).unwrap();
        for (name, _) in LOSS_CONSTANTS {
            let there = module.constants.iter().any(|(_, c)| c.name.as_deref() == Some(name));
            assert!(there, "{name} is not in {}", STRUCTURE.name);
        }
        for (here, there, named) in [
            ("const C1: f32 = 1e-4;", "const C1: f32 = 1e-3;", "constant C1"),
            ("const C2: f32 = 9e-4;", "const C2: f32 = 1e-4;", "constant C2"),
            ("const MIDDLE: u32 = 5u;", "const MIDDLE: u32 = 4u;", "constant MIDDLE"),
            ("    unused: vec2<u32>,", "    unused: vec4<u32>,", "struct Window"),
        ] {
            let text = STRUCTURE.text().replacen(here, there, 1);
            let found = faults(&STRUCTURE, &text, &structs());
            assert!(found.iter().any(|f| f.contains(named)), "{named}: {found:?}");
        }
    }

    #[test]
    fn every_constant_and_struct_is_in_the_shared_text() {
        let module = parse(LAYOUT).unwrap();
        for (name, _) in CONSTANTS {
            let there = module.constants.iter().any(|(_, c)| c.name.as_deref() == Some(name));
            assert!(there, "{name} is not in layout.wgsl");
        }
        for (name, ..) in [structs()[0].clone(), structs()[1].clone()] {
            assert!(module.types.iter().any(|(_, t)| t.name.as_deref() == Some(name)), "{name}");
        }
    }

    /// Each change breaks one agreement, and is found.
    #[test]
    fn a_shader_that_disagrees_is_found() {
        let good = PROJECT.text();
        let changes = [
            ("    columns: u32,\n    rows: u32,", "    rows: u32,\n    columns: u32,", "struct Splat"),
            ("    spare: u32,", "    spare: vec4<u32>,", "struct Frame"),
            ("const TILE: u32 = 16u;", "const TILE: u32 = 8u;", "constant TILE"),
            ("const REACH_MARGIN: f32 = 1e-4;", "const REACH_MARGIN: f32 = 1e-3;", "constant REACH_MARGIN"),
            ("@binding(6)", "@binding(9)", "bindings"),
            ("var<storage, read_write> keys", "var<storage, read> keys", "may not be"),
            ("fn is_finite(", "enable f16;\nfn is_finite(", "enable"),
            ("array<atomic<u32>, 8>", "array<atomic<u32>, 8000>", "workgroup memory"),
            ("@workgroup_size(256)", "@workgroup_size(512)", "workgroup of"),
        ];
        for (here, there, named) in changes {
            let text = good.replacen(here, there, 1);
            assert_ne!(text, good, "{here} is in the text");
            let found = faults(&PROJECT, &text, &structs());
            assert!(!found.is_empty(), "{there} went unseen");
            assert!(named == "may not be" || found.iter().any(|f| f.contains(named)), "{named}: {found:?}");
        }
    }
}
