//! New checksums for damaged files: without them a fuzzer sees little more of a reader than that the old ones do not hold.
//!
//! Written from `docs/formats.md`, and tolerant of everything: what cannot be followed is left as it is.

use embree_trace::format::checksum;

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    let field = bytes.get(at..at.checked_add(8)?)?;
    Some(u64::from_le_bytes(field.try_into().ok()?))
}

/// The bytes from `start`, `length` of them, when they are there.
fn part(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    bytes.get(usize::try_from(start).ok()?..usize::try_from(start.checked_add(length)?).ok()?)
}

/// Makes the checksums of the chunks and of the index hold.
pub fn rays(bytes: &mut [u8]) {
    let mut at = 64;
    while let Some(next) = chunk(bytes, at) {
        at = next;
    }
}

/// Mends the chunk or the index at `at`; where the next one would be.
fn chunk(bytes: &mut [u8], at: usize) -> Option<usize> {
    let magic = bytes.get(at..at + 4)?;
    if magic != b"RCHK" && magic != b"RIDX" {
        return None;
    }
    let stored = u64_at(bytes, at + 32)?;
    let sum = checksum(part(bytes, at as u64 + 64, stored)?);
    bytes.get_mut(at + 48..at + 56)?.copy_from_slice(&sum.to_le_bytes());
    Some((at + 64 + stored as usize).next_multiple_of(64))
}

/// Makes the checksums of the sections and of their table hold, the fingerprint, and the header's bounds.
pub fn bvh(bytes: &mut [u8]) {
    let Some(&[a, b, c, d]) = bytes.get(112..116) else { return };
    let sections = u32::from_le_bytes([a, b, c, d]) as usize;
    let Some(table_end) = 128usize.checked_add(32 * sections).filter(|&end| end <= bytes.len()) else {
        return;
    };
    for at in (128..table_end).step_by(32) {
        if section(bytes, at).is_none() {
            break;
        }
    }
    let sum = checksum(&bytes[128..table_end]);
    bytes[120..128].copy_from_slice(&sum.to_le_bytes());
}

/// Mends the entry of the table at `at`, and what the header says of it.
fn section(bytes: &mut [u8], at: usize) -> Option<()> {
    let tag: [u8; 4] = bytes.get(at..at + 4)?.try_into().ok()?;
    let element: [u8; 4] = bytes.get(at + 4..at + 8)?.try_into().ok()?;
    let (offset, count) = (u64_at(bytes, at + 8)?, u64_at(bytes, at + 16)?);
    let content = part(bytes, offset, count.checked_mul(u32::from_le_bytes(element).into())?)?;
    let sum = checksum(content).to_le_bytes();
    let root = content.get(..32).map(<[u8]>::to_vec);
    bytes[at + 24..at + 32].copy_from_slice(&sum);
    match (&tag, root) {
        (b"TRIS", _) => bytes[16..24].copy_from_slice(&sum),
        (b"NODE", Some(root)) => {
            bytes[24..36].copy_from_slice(&root[..12]);
            bytes[36..48].copy_from_slice(&root[16..28]);
        }
        _ => {}
    }
    Some(())
}
