//! Results for people: plots that could go in a paper.

pub mod plot;
