//! In place of `scenes.rs` in a library without Embree: there is no scene to ask.

use super::super::{Candidate, CompareError, Recording};
use super::{AnswersOnTrees, Kernels, Wanted};
use crate::progress::Progress;
use crate::replay::query::{Choice, Query};

/// None is ever made.
pub enum EmbreeScenes {}

impl EmbreeScenes {
    pub fn of(_: &[Candidate], _: Wanted) -> Result<EmbreeScenes, String> {
        Err("this program was built without Embree".to_owned())
    }

    pub fn kernels(&self) -> &Kernels {
        match *self {}
    }

    pub fn answers(
        &mut self,
        _: &[Candidate],
        _: &Recording,
        _: &Choice,
        _: &Progress,
    ) -> Result<AnswersOnTrees, CompareError> {
        match *self {}
    }

    pub fn round<'a, Run: Iterator<Item = Query<'a>>>(
        &mut self,
        _: usize,
        _: impl Iterator<Item = Run>,
    ) -> Option<Vec<f64>> {
        match *self {}
    }
}
