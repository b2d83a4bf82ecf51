//! Everything that an occlusion query could meet, whatever the order: the nodes whose boxes its segment overlaps, what each costs to
//! open, and whether an occluder is below. What any order costs, and the least that a proof of occlusion costs, follow
//! from it without another box test.

use super::blocks::{BlockRay, Blocks};
use super::candidates::Candidates;
use super::form::{Form, Link, Stack};
use super::leaf::{self, Best};
use super::observer::{Counts, Observer};
use super::overlap::Overlapped;
use super::ray::PreparedRay;
use super::simd::Machine;
use super::triangle::PreparedTriangle;

/// A node whose box a query's segment overlaps. The encounters of a query stand in depth-first order, children in the order of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encounter {
    /// Index in the file.
    pub node: u32,
    /// Encounters of the subtree, this one included.
    pub size: u32,
    /// Where the ray enters the box.
    pub entry: f32,
    /// Inner node: its children, whose boxes are tested. Leaf: triangles tested, up to the first that occludes.
    pub tests: u32,
    pub leaf: bool,
    /// Whether an occluder is in it.
    pub occluded: bool,
}

impl Encounter {
    /// What opening the node costs, without what is below.
    #[inline]
    pub fn own(&self) -> Counts {
        if self.leaf {
            Counts { primitive_tests: self.tests.into(), ..Counts::default() }
        } else {
            Counts { box_tests: self.tests.into(), node_visits: 1, ..Counts::default() }
        }
    }
}

/// The places of the children of the encounter at `place`, in the order of the file.
#[inline]
pub fn children(encounters: &[Encounter], place: usize) -> impl Iterator<Item = usize> {
    let end = place + encounters[place].size as usize;
    let mut next = place + 1;
    std::iter::from_fn(move || {
        let child = next;
        (child < end).then(|| {
            next += encounters[child].size as usize;
            child
        })
    })
}

/// The cheapest proof of a query's answer: what is opened when at every node the right child is taken first, the one whose own
/// cheapest proof has the fewest box and primitive tests. For a ray that is not occluded, all of it. The root's box test is not
/// counted.
///
/// No order of children, however clever, costs an occlusion query less. The triangles of a leaf stay in their order.
pub fn cheapest_proof(encounters: &[Encounter]) -> Counts {
    let mut proofs = vec![Counts::default(); encounters.len()];
    for place in (0..encounters.len()).rev() {
        let mut sum = encounters[place].own();
        let below = children(encounters, place);
        if encounters[place].occluded {
            let proof = below
                .filter(|&child| encounters[child].occluded)
                .map(|child| proofs[child])
                .min_by_key(|proof| (proof.box_tests + proof.primitive_tests, proof.node_visits));
            sum += proof.unwrap_or_default();
        } else {
            below.for_each(|child| sum += proofs[child]);
        }
        proofs[place] = sum;
    }
    proofs.first().copied().unwrap_or_default()
}

/// How many nodes are overlapped.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Overlaps(pub usize);

impl Overlapped for Overlaps {
    fn inner(&mut self, _node: &Link) {
        self.0 += 1;
    }

    fn leaf(&mut self, _leaf: &Link) {
        self.0 += 1;
    }
}

/// Counts the triangles of one leaf.
struct Tested(u32);

impl Observer for Tested {
    fn primitive(&mut self, _triangle: &PreparedTriangle) {
        self.0 += 1;
    }
}

/// Adds the encounters of a query to `found`; the ray overlaps the box of `root`.
pub(super) fn run<M: Machine, F: Form<M>>(
    form: &F,
    root: Link,
    blocks: &Blocks,
    ray: &PreparedRay,
    candidates: &impl Candidates,
    mut stack: Stack,
    found: &mut Vec<Encounter>,
) {
    let (form_ray, block_ray) = (F::ray(ray), BlockRay::new(ray));
    let start = found.len();
    stack.push(root);
    while let Some(current) = stack.pop() {
        let mut encounter = Encounter {
            node: current.node,
            size: 0,
            entry: current.entry,
            tests: 0,
            leaf: false,
            occluded: false,
        };
        if current.is_leaf() {
            let mut tested = Tested(0);
            let mut best = Best::end_of(ray);
            encounter.leaf = true;
            encounter.occluded =
                leaf::test::<true, M>(&current, blocks, ray, &block_ray, candidates, &mut tested, &mut best);
            encounter.tests = tested.0;
        } else {
            let before = stack.len();
            form.each(&current, &form_ray, ray.tfar, |child| stack.push(child));
            let pushed = stack.above(before);
            pushed.reverse();
            encounter.tests = current.count;
            // Until sizes are known: the number of children.
            encounter.size = pushed.len() as u32;
        }
        found.push(encounter);
    }
    let found = &mut found[start..];
    for place in (0..found.len()).rev() {
        let (mut end, mut occluded) = (place + 1, found[place].occluded);
        for _ in 0..found[place].size {
            occluded |= found[end].occluded;
            end += found[end].size as usize;
        }
        found[place].size = (end - place) as u32;
        found[place].occluded = occluded;
    }
}
