//! What is counted in the background, tree by tree: a recording's queries over the tree, and what that says of nodes and triangles.

use super::load::{OpenTree, Recording};
use super::work::{Wake, Work};
use crate::explore::count::Counted;
use crate::explore::queries::Source;
use crate::explore::shares::Shares;
use crate::progress::Progress;
use crate::replay::query::Choice;
use crate::replay::tally::Costs;
use crate::traverse::Traversal;
use std::sync::Arc;

/// Queries that are asked for a first answer, which is there at once, and for the one that stays. More are sampled.
const LIMITS: [u64; 2] = [50_000, 2_000_000];

/// What was counted, and for what.
pub struct Results {
    asked: Option<Traversal>,
    work: Option<Work<Result<Shares, String>>>,
    progress: Arc<Progress>,
    pub shares: Option<Arc<Shares>>,
    pub error: Option<String>,
}

impl Default for Results {
    fn default() -> Results {
        let progress = Arc::new(Progress::watched(1));
        Results { asked: None, work: None, progress, shares: None, error: None }
    }
}

impl Results {
    /// Starts counting when it has to, and takes what is there. Returns whether there is something new.
    pub fn update(
        &mut self,
        tree: &Arc<OpenTree>,
        recording: Option<&Arc<Recording>>,
        traversal: Traversal,
        wake: &Wake,
    ) -> bool {
        let Some(recording) = recording else { return false };
        if self.asked != Some(traversal) {
            self.progress.stop();
            self.asked = Some(traversal);
            self.start(tree, recording, traversal, wake);
        }
        let Some(work) = &mut self.work else { return false };
        let newest = work.newest();
        if work.has_ended() {
            self.work = None;
        }
        match newest {
            Some(Ok(shares)) => self.shares = Some(Arc::new(shares)),
            Some(Err(error)) => self.error = Some(error),
            None => return false,
        }
        true
    }

    /// How much of the counting is done, while it goes on.
    pub fn fraction(&self) -> Option<f64> {
        self.work.as_ref().map(|_| self.progress.fraction())
    }

    fn start(&mut self, tree: &Arc<OpenTree>, recording: &Arc<Recording>, traversal: Traversal, wake: &Wake) {
        let (tree, recording) = (tree.clone(), recording.clone());
        let steps = LIMITS.iter().map(|&limit| source(&recording, limit).steps()).sum();
        let progress = Arc::new(Progress::watched(steps));
        self.progress = progress.clone();
        self.work = Some(Work::start(wake, move |_, give| {
            let asked = tree.asked(traversal);
            // Threads of its own: pictures do not wait behind it.
            let Ok(pool) = rayon::ThreadPoolBuilder::new().build() else { return };
            for limit in LIMITS {
                let counted =
                    pool.install(|| Counted::of(&tree.walk, &asked, &source(&recording, limit), &progress));
                if progress.is_stopped() {
                    return;
                }
                let shares = counted.map(|counted| Shares::of(&tree.walk, counted, tree.price, COSTS));
                let all = shares.as_ref().map_or(true, |shares| shares.counted.sampled.is_all());
                give(shares.map_err(|error| error.to_string()));
                if all {
                    return;
                }
            }
        }));
    }
}

impl Drop for Results {
    fn drop(&mut self) {
        self.progress.stop();
    }
}

fn source(recording: &Recording, limit: u64) -> Source<'_> {
    Source { rays: &recording.rays, choice: every_query(recording), limit }
}

/// What tests count in Γ, everywhere in the window.
pub const COSTS: Costs = Costs { c_i: 1.0, c_p: 1.0 };

/// All queries of the scene that is shown.
pub fn every_query(recording: &Recording) -> Choice {
    Choice { scene: recording.scene, filter: Default::default(), held_out: None, sample: None }
}
