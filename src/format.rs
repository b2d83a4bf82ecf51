//! The two file formats, each read and written in one place. `../docs/formats.md` is their public specification.
//!
//! Parsers borrow `&[u8]` and never open a file ([`crate::files`] does, for the binaries). Everything is checked
//! before it is followed; an error names the byte offset, what was found and what was expected.

pub mod bvh;
pub mod rays;
