//! Properties of both formats over files that a description makes: any content that the writer takes, of any size that matters.

use crate::fuzz::bvh_file::{self, Pieces as BvhPieces, Remake as BvhRemake};
use crate::fuzz::rays::Content;
use crate::fuzz::rays_file::{self, Pieces, Remake};
use crate::fuzz::{TARGETS, bvh, queries, rays, table};
use arbitrary::{Arbitrary, Unstructured};
use embree_trace::convert::Kind;
use embree_trace::format::bvh::{Bvh, Section};
use embree_trace::format::rays::{Rays, flag};
use proptest::prelude::*;
use std::fmt::Debug;

/// What random bytes describe.
fn described<T: Debug + for<'a> Arbitrary<'a>>() -> impl Strategy<Value = T> {
    prop::collection::vec(any::<u8>(), 0..3000)
        .prop_filter_map("describes nothing", |bytes| Unstructured::new(&bytes).arbitrary().ok())
}

/// Few enough records to try every bit.
fn small(mut file: rays_file::File) -> rays_file::File {
    file.chunks.truncate(2);
    for chunk in &mut file.chunks {
        chunk.records.truncate(4);
        chunk.rejects.retain(|reject| (reject.record as usize) < chunk.records.len());
        chunk.records.iter_mut().for_each(|record| record.flags &= !flag::HAS_REJECTS);
        chunk
            .rejects
            .iter()
            .for_each(|reject| chunk.records[reject.record as usize].flags |= flag::HAS_REJECTS);
    }
    file
}

/// Everything in a `.rays`, where nothing is refused.
fn content(bytes: &[u8]) -> Option<Content> {
    Rays::parse(bytes).and_then(|rays| Content::of(&rays)).ok()
}

/// The bytes as a map has them.
fn aligned(bytes: &[u8]) -> Vec<u64> {
    let mut words = vec![0; bytes.len().div_ceil(8)];
    bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
    words
}

/// What a bit of a `.rays` is to a reader.
#[derive(Debug, PartialEq)]
enum Bit {
    /// A file with the other value is refused.
    Detected,
    /// It says something that no checksum covers: the header's or a chunk's describing fields. No query depends on it.
    Describes,
    /// Nobody looks at it: reserved fields, the minor version, zeros between chunks; the end mark, without which all is recovered.
    Harmless,
}

/// By `docs/formats.md`: all that is not listed here is detected.
fn bit_of_rays(position: usize, bit: usize, chunks: &[(usize, usize)], index: usize, length: usize) -> Bit {
    let in_chunk = chunks.iter().rev().find(|(offset, _)| *offset <= position && position < index);
    match (position, in_chunk) {
        (10..12, _) => Bit::Harmless,
        (28..32, _) if (position, bit) != (28, 0) => Bit::Harmless,
        (16..64, _) => Bit::Describes,
        (_, Some((offset, end))) => match position - offset {
            6..8 | 16..20 | 24..32 => Bit::Describes,
            5 | 20..24 | 56..64 => Bit::Harmless,
            _ if position >= *end => Bit::Harmless,
            _ => Bit::Detected,
        },
        _ if position >= length - 8 => Bit::Harmless,
        _ if position >= index && matches!(position - index, 5..32 | 56..64) => Bit::Harmless,
        _ => Bit::Detected,
    }
}

/// By `docs/formats.md`: whether a file with the other value is still read, with the same nodes, primitives, triangles and geometries.
fn bvh_keeps(bytes: &[u8], bvh: &Bvh, position: usize, bit: usize) -> bool {
    let in_section =
        |section: &Section| (section.offset..section.offset + section.bytes()).contains(&(position as u64));
    match position {
        // Minor version, flags, producer, reserved.
        10..12 | 60..112 | 116..120 => true,
        // The sign of a zero makes no other box.
        24..48 => {
            position % 4 == 3 && bit == 7 && matches!(bytes[position - 3..=position], [0, 0, 0, 0 | 0x80])
        }
        // Of a root alone, 0 children are as true as 2.
        48 => bit == 1 && bvh.tree.nodes.len() == 1,
        _ => position >= 128 + 32 * bvh.sections.len() && !bvh.sections.iter().any(in_section),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn a_rays_holds_what_was_written(file in described::<rays_file::File>()) {
        let bytes = file.bytes();
        prop_assert_eq!(content(&bytes), Some(file.content()));
        rays::check(&bytes);
    }

    #[test]
    fn a_bvh_holds_what_was_written(file in described::<bvh_file::File>()) {
        let bytes = file.bytes();
        let words = aligned(&bytes);
        let bvh = Bvh::parse(&bytemuck::cast_slice(&words)[..bytes.len()]).unwrap();
        prop_assert_eq!(bvh.tree.nodes, &file.tree.nodes[..]);
        prop_assert_eq!(bvh.tree.primitives, &file.tree.primitives[..]);
        let raw = |triangles| bytemuck::cast_slice::<_, u8>(triangles).to_vec();
        prop_assert_eq!(raw(bvh.triangles), raw(&file.triangles));
        prop_assert_eq!(bvh.geometries, &file.geometries[..]);
        prop_assert_eq!((bvh.order, bvh.meta), (file.order.as_deref(), file.meta.as_deref()));
        prop_assert_eq!((bvh.header.flags, &bvh.header.producer), (file.flags, &file.producer));
        bvh::check(&bytes);
    }

    #[test]
    fn a_table_holds_what_was_written(file in described::<rays_file::File>()) {
        let (bytes, expected) = table::ours(&file);
        prop_assert_eq!(queries::read(&bytes, Kind::Parquet).ok(), Some(expected));
    }

    #[test]
    fn chunks_in_any_order_are_the_same_queries(file in described::<rays_file::File>(), seed in any::<[u8; 5]>()) {
        let bytes = file.bytes();
        let queries = file.content().queries();
        let mut pieces = Pieces::of(&bytes);
        for (at, other) in seed.into_iter().enumerate().take(pieces.chunks.len()) {
            let other = at + other as usize % (pieces.chunks.len() - at);
            pieces.chunks.swap(at, other);
        }
        let order = pieces.order().unwrap();
        let mut expected = file.content();
        expected.chunks = order.iter().map(|&number| expected.chunks[number].clone()).collect();

        prop_assert_eq!(content(&pieces.bytes(Remake::ALL)), Some(expected.clone()));
        prop_assert_eq!(expected.queries(), queries.clone());
        let killed = pieces.bytes_without_index();
        prop_assert_eq!(content(&killed), Some(expected));
        prop_assert_eq!(Rays::parse(&killed).unwrap().recovery.unwrap().lost_bytes, 0);
        // The old index either fits (chunks of the same sizes changed places) or the file is refused.
        if let Some(found) = content(&pieces.bytes(Remake { entries: false, ..Remake::ALL })) {
            prop_assert_eq!(found.queries(), queries);
        }
    }

    #[test]
    fn sections_in_any_order_are_the_same_tree(file in described::<bvh_file::File>(), seed in any::<[(u8, u8); 6]>()) {
        let bytes = file.bytes();
        let mut pieces = BvhPieces::of(&bytes);
        let count = pieces.sections.len();
        for (at, (entry, place)) in seed.into_iter().enumerate().take(count) {
            pieces.sections.swap(at, at + entry as usize % (count - at));
            pieces.places.swap(at, at + place as usize % (count - at));
        }
        let changed = pieces.bytes(BvhRemake::ALL);
        let (before, after) = (aligned(&bytes), aligned(&changed));
        bvh_file::assert_same(
            &bytemuck::cast_slice(&before)[..bytes.len()],
            &bytemuck::cast_slice(&after)[..changed.len()],
        );
    }

    #[test]
    fn targets_hold_for_any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        TARGETS.iter().for_each(|target| (target.check)(&bytes));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_rays_cut_anywhere_tells_what_was_lost(file in described::<rays_file::File>()) {
        let bytes = file.bytes();
        let whole = content(&bytes).unwrap();
        let rays = Rays::parse(&bytes).unwrap();
        let ends: Vec<usize> =
            rays.chunks().iter().map(|chunk| (chunk.body() + chunk.stored_bytes) as usize).collect();
        let index = ends.last().map_or(64, |end| end.next_multiple_of(64));
        for length in 0..bytes.len() {
            let Ok(cut) = Rays::parse(&bytes[..length]) else {
                prop_assert!(length < 64);
                continue;
            };
            let kept = ends.iter().filter(|&&end| end <= length).count();
            let known = ends[..kept].last().map_or(64, |end| end.next_multiple_of(64).min(length));
            // Of an index nothing is lost, once it is seen to be one.
            let lost = if length >= index + 4 { 0 } else { length - known };
            prop_assert_eq!(cut.recovery.unwrap().lost_bytes, lost as u64, "{}", length);
            let found = Content::of(&cut).unwrap();
            prop_assert_eq!(&found.header, &whole.header);
            prop_assert!(found.chunks == whole.chunks[..kept], "{}", length);
        }
    }

    #[test]
    fn a_bvh_cut_anywhere_is_refused(file in described::<bvh_file::File>()) {
        let bytes = file.bytes();
        let words = aligned(&bytes);
        for length in 0..bytes.len() {
            prop_assert!(Bvh::parse(&bytemuck::cast_slice(&words)[..length]).is_err(), "{}", length);
        }
    }

    #[test]
    fn each_bit_of_a_rays_is_detected_or_on_the_list(file in described::<rays_file::File>()) {
        let bytes = small(file).bytes();
        let right = content(&bytes).unwrap();
        let rays = Rays::parse(&bytes).unwrap();
        let chunks: Vec<(usize, usize)> = (rays.chunks().iter())
            .map(|chunk| (chunk.offset as usize, (chunk.body() + chunk.stored_bytes) as usize))
            .collect();
        let index = bytes.len() - 16 - 16 * chunks.len() - 64;
        let mut flipped = bytes.clone();
        for position in 0..bytes.len() {
            for bit in 0..8 {
                flipped[position] ^= 1 << bit;
                let found = content(&flipped);
                flipped[position] ^= 1 << bit;
                let expected = bit_of_rays(position, bit, &chunks, index, bytes.len());
                match found {
                    None => prop_assert_eq!(expected, Bit::Detected, "bit {} of byte {}", bit, position),
                    Some(found) if expected == Bit::Harmless => prop_assert_eq!(&found, &right, "bit {} of byte {}", bit, position),
                    Some(found) => {
                        prop_assert_eq!(expected, Bit::Describes, "bit {} of byte {}", bit, position);
                        let bodies = |content: &Content| -> Vec<_> {
                            content.chunks.iter().map(|(_, records, rejects)| (records.clone(), rejects.clone())).collect()
                        };
                        prop_assert_eq!(bodies(&found), bodies(&right));
                    }
                }
            }
        }
    }

    #[test]
    fn each_bit_of_a_bvh_is_detected_or_on_the_list(file in described::<bvh_file::File>()) {
        let bytes = file.bytes();
        let (right, mut words) = (aligned(&bytes), aligned(&bytes));
        let bvh = Bvh::parse(&bytemuck::cast_slice(&right)[..bytes.len()]).unwrap();
        for position in 0..bytes.len() {
            for bit in 0..8 {
                bytemuck::cast_slice_mut::<_, u8>(&mut words)[position] ^= 1 << bit;
                let read = Bvh::parse(&bytemuck::cast_slice(&words)[..bytes.len()]).is_ok();
                bytemuck::cast_slice_mut::<_, u8>(&mut words)[position] ^= 1 << bit;
                prop_assert_eq!(read, bvh_keeps(&bytes, &bvh, position, bit), "bit {} of byte {}", bit, position);
            }
        }
    }
}
