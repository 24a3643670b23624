//! Repair: XOR against a plain sum, the code against elimination by definition.

use codec_core::internals::{
    limits::{MAX_PACKET_BYTES, MAX_REPAIR_PARITY, MAX_REPAIR_SET},
    repair::{LENGTH_BYTES, MAX_CODED_BYTES, Sums, cauchy, gf256, set_bytes},
};

use crate::input::Choices;

/// Everything one set has been told, kept whole.
struct Model {
    longest: usize,
    members: Vec<Option<Vec<u8>>>,
    rows: Vec<Option<Vec<u8>>>,
}

impl Model {
    /// A packet as it is coded: length, bytes, zeros.
    fn coded(&self, length: u16, bytes: &[u8]) -> Vec<u8> {
        let mut coded = [&length.to_le_bytes()[..], bytes].concat();
        coded.resize(LENGTH_BYTES + self.longest, 0);
        coded
    }

    /// What is missing of the first `members`, by elimination over the first rows that suffice.
    fn solve(&self, members: usize) -> Option<Vec<(u32, Vec<u8>)>> {
        let missing: Vec<usize> = (0..members).filter(|&j| self.members[j].is_none()).collect();
        let rows: Vec<usize> = (0..self.rows.len()).filter(|&i| self.rows[i].is_some()).collect();
        if missing.is_empty() || rows.len() < missing.len() {
            return None;
        }
        // One equation per row: coefficients of what is missing, then the right-hand side.
        let equation = |&i: &usize| {
            let mut right = self.rows[i].clone()?;
            for (j, member) in self.members.iter().enumerate() {
                if let Some(member) = member {
                    gf256::slow::mul_add(&mut right, member, coefficient(i, j));
                }
            }
            Some((missing.iter().map(|&j| coefficient(i, j)).collect::<Vec<u8>>(), right))
        };
        let mut equations: Vec<(Vec<u8>, Vec<u8>)> =
            rows.iter().take(missing.len()).filter_map(equation).collect();
        for at in 0..missing.len() {
            let pivot = (at..equations.len()).find(|&e| equations[e].0[at] != 0);
            assert!(pivot.is_some(), "every square part is invertible");
            equations.swap(at, pivot.unwrap_or(at));
            let scale = divide(1, equations[at].0[at]);
            for value in equations[at].0.iter_mut() {
                *value = gf256::slow::mul(*value, scale);
            }
            for value in equations[at].1.iter_mut() {
                *value = gf256::slow::mul(*value, scale);
            }
            let (left, right) = equations[at].clone();
            for (e, equation) in equations.iter_mut().enumerate().filter(|(e, _)| *e != at) {
                let factor = equation.0[at];
                assert!(e != at);
                gf256::slow::mul_add(&mut equation.0, &left, factor);
                gf256::slow::mul_add(&mut equation.1, &right, factor);
            }
        }
        Some(missing.iter().map(|&j| j as u32).zip(equations.into_iter().map(|e| e.1)).collect())
    }
}

/// `a / b` by trial.
fn divide(a: u8, b: u8) -> u8 {
    (0..=255u8).find(|&q| gf256::slow::mul(q, b) == a).unwrap_or(0)
}

/// The coefficient of row `i` at position `j`, from its definition; each found once.
fn coefficient(i: usize, j: usize) -> u8 {
    static ALL: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    let all = ALL.get_or_init(|| {
        let one = |at: usize| {
            let (i, y) = ((at / MAX_REPAIR_SET) as u8, (at % MAX_REPAIR_SET + MAX_REPAIR_PARITY) as u8);
            divide(y, y ^ i)
        };
        (0..MAX_REPAIR_PARITY * MAX_REPAIR_SET).map(one).collect()
    });
    all[i * MAX_REPAIR_SET + j]
}

fn run(data: &[u8], most_rows: usize) {
    let mut choices = Choices::new(data);
    let members = usize::from(choices.u8()) % (MAX_REPAIR_SET + 2);
    let rows = usize::from(choices.u8()) % most_rows + 1;
    let longest = usize::from(choices.u8()) * 6 % MAX_PACKET_BYTES + 1;
    let mut memory = vec![0u8; set_bytes(rows, longest)];
    assert!(Sums::over(&mut memory[1..], rows, longest).is_none());
    let Some(mut sums) = Sums::over(&mut memory, rows, longest) else { return };
    let mut model = Model { longest, members: vec![None; MAX_REPAIR_SET], rows: vec![None; rows] };
    while !choices.is_empty() {
        let (op, place) = (choices.u8(), choices.u8() % 80);
        let len = if op & 8 == 0 { choices.below(24) } else { choices.below(longest + 20) };
        let bytes = choices.take(len);
        let at = usize::from(place);
        if op & 3 == 3 {
            let length = choices.u16() % 1400;
            let row = at % 10;
            sums.add_parity(row as u32, length, bytes);
            if let Some(None) = model.rows.get(row)
                && bytes.len() <= longest
            {
                model.rows[row] = Some(model.coded(length, bytes));
            }
        } else if op & 3 == 2 {
            // A run of like members.
            for at in at..at + usize::from(op >> 4) {
                add(&mut sums, &mut model, at, bytes);
            }
        } else {
            add(&mut sums, &mut model, at, bytes);
        }
    }
    let expected = model.solve(members.min(MAX_REPAIR_SET));
    let solution = sums.solution(members as u32);
    assert_eq!(solution.is_some(), expected.is_some());
    let (Some(solution), Some(expected)) = (solution, expected) else { return };
    let positions: Vec<u32> = solution.positions().collect();
    assert_eq!(positions, expected.iter().map(|e| e.0).collect::<Vec<_>>());
    let mut out = [0u8; MAX_CODED_BYTES];
    for (index, (position, coded)) in expected.iter().enumerate() {
        let length = usize::from(u16::from_le_bytes([coded[0], coded[1]]));
        let wanted = coded[LENGTH_BYTES..].get(..length).filter(|bytes| !bytes.is_empty());
        assert_eq!(sums.recover(&solution, index, &mut out), wanted);
        if let Some(packet) = wanted
            && index % 2 == 0
        {
            // Only what codes to the very same bytes leaves the others as they are.
            if model.coded(packet.len() as u16, packet) == *coded {
                sums.add(*position, packet);
            }
        }
    }
}

fn add(sums: &mut Sums<'_>, model: &mut Model, at: usize, bytes: &[u8]) {
    sums.add(at as u32, bytes);
    if let Some(None) = model.members.get(at)
        && bytes.len() <= model.longest
    {
        model.members[at] = Some(model.coded(bytes.len() as u16, bytes));
    }
}

/// XOR repair: one row. Input: members, 0, longest, then operations.
pub fn repair(data: &[u8]) {
    run(data, 1);
    assert_eq!(cauchy::coefficient(0, u32::from(data.first().copied().unwrap_or(0)) % 64), Some(1));
}

/// The code with up to eight rows. Input: members, rows, longest, then operations.
pub fn cauchy(data: &[u8]) {
    run(data, MAX_REPAIR_PARITY);
}
