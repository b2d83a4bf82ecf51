//! Sets of pixels: small for an image, and for any recording a fraction of its size.

use std::collections::BTreeMap;

/// A set of paths ([`Record::path`](crate::format::rays::Record::path)), 64 neighbours to a word.
#[derive(Clone, Debug, Default)]
pub(super) struct PathSet {
    words: BTreeMap<u32, u64>,
}

impl PathSet {
    /// Whether it was not there before.
    pub(super) fn insert(&mut self, path: u32) -> bool {
        let word = self.words.entry(path >> 6).or_default();
        let bit = 1 << (path & 63);
        let is_new = *word & bit == 0;
        *word |= bit;
        is_new
    }

    pub(super) fn remove(&mut self, path: u32) {
        if let Some(word) = self.words.get_mut(&(path >> 6)) {
            *word &= !(1 << (path & 63));
            if *word == 0 {
                self.words.remove(&(path >> 6));
            }
        }
    }

    pub(super) fn contains(&self, path: u32) -> bool {
        self.words.get(&(path >> 6)).is_some_and(|word| word >> (path & 63) & 1 != 0)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    pub(super) fn len(&self) -> u64 {
        self.words.values().map(|word| u64::from(word.count_ones())).sum()
    }

    /// How many are in this set and not in the other one.
    pub(super) fn count_without(&self, other: &PathSet) -> u64 {
        let without = |(place, word): (&u32, &u64)| {
            let others = other.words.get(place).copied().unwrap_or(0);
            u64::from((word & !others).count_ones())
        };
        self.words.iter().map(without).sum()
    }

    /// Adds what is in the other set.
    pub(super) fn unite(&mut self, other: PathSet) {
        for (place, word) in other.words {
            *self.words.entry(place).or_default() |= word;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_a_set() {
        let mut set = PathSet::default();
        assert!(set.insert(5) && set.insert(64) && set.insert(u32::MAX - 1) && !set.insert(64));
        assert!(set.contains(5) && !set.contains(6) && set.len() == 3);
        let mut other = PathSet::default();
        other.insert(64);
        assert_eq!(set.count_without(&other), 2);
        other.unite(set.clone());
        assert_eq!(other.len(), 3);
        set.remove(64);
        set.remove(5);
        assert!(!set.contains(64) && set.len() == 1 && !set.is_empty());
        set.remove(u32::MAX - 1);
        assert!(set.is_empty());
    }
}
