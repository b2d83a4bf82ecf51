//! `trace-convert`: files of 2011 written byte by byte from `docs/formats.md`, arrays read by NumPy itself, and damage of all of them.

mod hostile;
mod queries;
mod support;
mod trees;
