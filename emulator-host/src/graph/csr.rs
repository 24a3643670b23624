//! Stores rows of indices in one allocation (compressed sparse rows).

/// `row(i)` is a slice of a shared table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Csr {
    ends: Vec<u32>,
    items: Vec<u32>,
}

impl Csr {
    /// Rows `0..rows` from (row, item) pairs; items keep the order of the pairs.
    pub(crate) fn from_pairs(rows: usize, pairs: &[(u32, u32)]) -> Self {
        let mut ends = vec![0u32; rows];
        for (row, _) in pairs {
            ends[*row as usize] += 1;
        }
        let mut total = 0;
        for end in &mut ends {
            let length = *end;
            *end = total;
            total += length;
        }
        let mut items = vec![0u32; pairs.len()];
        for (row, item) in pairs {
            let next = &mut ends[*row as usize];
            items[*next as usize] = *item;
            *next += 1;
        }
        Self { ends, items }
    }

    /// Rows one by one, in order.
    pub(crate) fn push_row(&mut self, row: impl IntoIterator<Item = u32>) {
        self.items.extend(row);
        self.ends.push(self.items.len() as u32);
    }

    /// Items over all rows.
    pub(crate) fn len(&self) -> usize {
        self.items.len()
    }

    pub(crate) fn row(&self, row: usize) -> &[u32] {
        let start = if row == 0 { 0 } else { self.ends[row - 1] };
        &self.items[start as usize..self.ends[row] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::Csr;

    #[test]
    fn rows_keep_their_items_in_order() {
        let csr = Csr::from_pairs(3, &[(2, 7), (0, 1), (2, 5)]);
        assert_eq!([csr.row(0), csr.row(1), csr.row(2)], [&[1u32][..], &[], &[7, 5]]);
        let mut pushed = Csr::default();
        pushed.push_row([1]);
        pushed.push_row([]);
        assert_eq!([pushed.row(0), pushed.row(1)], [&[1u32][..], &[]]);
    }
}
