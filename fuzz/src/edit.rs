//! Changes to fields of a file: values at which readers tend to be wrong.

use arbitrary::{Arbitrary, Result, Unstructured};

/// What a field becomes.
#[derive(Clone, Copy, Debug, Arbitrary)]
pub enum Value {
    Set(u64),
    Add(i8),
    /// One of [`EDGES`].
    Edge(u8),
}

/// Borders of types and of the formats' limits.
const EDGES: [u64; 16] = [
    0,
    1,
    2,
    63,
    64,
    65_536,
    65_537,
    16 << 20,
    (16 << 20) + 8,
    0x7FFF_FFFF,
    0x8000_0000,
    0xFFFF_FFFF,
    1 << 32,
    u64::MAX - 63,
    u64::MAX >> 1,
    u64::MAX,
];

impl Value {
    /// Changes the little-endian number that fills `field`, of at most 8 bytes.
    pub fn apply(self, field: &mut [u8]) {
        let mut bytes = [0; 8];
        bytes[..field.len()].copy_from_slice(field);
        let value = match self {
            Value::Set(value) => value,
            Value::Add(delta) => u64::from_le_bytes(bytes).wrapping_add_signed(delta.into()),
            Value::Edge(number) => EDGES[number as usize % EDGES.len()],
        };
        field.copy_from_slice(&value.to_le_bytes()[..field.len()]);
    }
}

/// Damage to the bytes of a whole file, which no checksum hides.
#[derive(Clone, Copy, Debug, Arbitrary)]
enum Damage {
    /// Only so many bytes are left, modulo the length.
    Cut(u16),
    Flip {
        at: u16,
        bit: u8,
    },
    /// Zeros between two bytes.
    Insert {
        at: u16,
        count: u8,
    },
}

impl Damage {
    fn apply(self, bytes: &mut Vec<u8>) {
        let within = |at: u16, length: usize| at as usize % length.max(1);
        match self {
            Damage::Cut(length) => bytes.truncate(within(length, bytes.len())),
            Damage::Flip { at, bit } => {
                let at = within(at, bytes.len());
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Damage::Insert { at, count } => {
                let at = within(at, bytes.len());
                bytes.splice(at..at, std::iter::repeat_n(0, count.into()));
            }
        }
    }
}

/// Up to two damages; whether there were any.
pub fn damage(u: &mut Unstructured, bytes: &mut Vec<u8>) -> Result<bool> {
    let count = u.int_in_range(0..=2u8)?;
    for _ in 0..count {
        u.arbitrary::<Damage>()?.apply(bytes);
    }
    Ok(count > 0)
}

/// Sets the byte at a place, modulo the length.
pub fn set(bytes: &mut [u8], at: u16, value: u8) {
    let at = at as usize % bytes.len().max(1);
    if let Some(byte) = bytes.get_mut(at) {
        *byte = value;
    }
}

/// The element that a number in a description names, if there is any.
pub fn pick<T>(elements: &mut [T], number: u8) -> Option<&mut T> {
    let index = number as usize % elements.len().max(1);
    elements.get_mut(index)
}
