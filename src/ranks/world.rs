//! The ranks of an MPI job.

use super::Ranks;
use mpi::collective::SystemOperation;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives, Destination, Source};
use mpi::{Count, Threading};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bytes and values of one message, because MPI counts with 31 bits.
const PIECE: usize = 1 << 30;

/// All processes that `mpirun` or a scheduler started.
pub struct World {
    universe: Universe,
    /// Held in every call: MPI was told that there is one at a time.
    calling: Mutex<()>,
}

impl World {
    /// Starts MPI, once in a process. None where that fails, or where other threads than this one could not call it.
    pub fn start() -> Option<World> {
        let (universe, threading) = mpi::initialize_with_threading(Threading::Serialized)?;
        (threading >= Threading::Serialized).then(|| World { universe, calling: Mutex::new(()) })
    }

    fn world(&self) -> (SimpleCommunicator, MutexGuard<'_, ()>) {
        // A panic while calling leaves nothing half done here.
        (self.universe.world(), self.calling.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Ranks for World {
    fn rank(&self) -> usize {
        self.world().0.rank() as usize
    }

    fn count(&self) -> usize {
        self.world().0.size() as usize
    }

    fn send(&self, to: usize, message: &[u8]) {
        let (world, _calling) = self.world();
        let process = world.process_at_rank(to as i32);
        process.send(&(message.len() as u64));
        for piece in message.chunks(PIECE) {
            process.send(piece);
        }
    }

    fn receive(&self, from: usize) -> Vec<u8> {
        let (world, _calling) = self.world();
        let process = world.process_at_rank(from as i32);
        let (length, _) = process.receive::<u64>();
        let mut message = vec![0; length as usize];
        for piece in message.chunks_mut(PIECE) {
            process.receive_into(piece);
        }
        message
    }

    fn sum(&self, values: &mut [u64]) {
        let (world, _calling) = self.world();
        for piece in values.chunks_mut(PIECE) {
            let own = piece.to_vec();
            world.all_reduce_into(&own[..], piece, SystemOperation::sum());
        }
    }

    fn exchange(&self, message: &[u8]) -> Vec<Vec<u8>> {
        let (world, _calling) = self.world();
        let mut lengths = vec![0u64; world.size() as usize];
        world.all_gather_into(&(message.len() as u64), &mut lengths[..]);
        let mut messages: Vec<Vec<u8>> =
            lengths.iter().map(|&length| Vec::with_capacity(length as usize)).collect();
        // All together go in pieces that MPI can count.
        let most = PIECE / lengths.len();
        let rounds = lengths.iter().map(|&length| (length as usize).div_ceil(most)).max().unwrap_or(0);
        for round in 0..rounds {
            let part = |length: usize| (length.min(round * most), length.min((round + 1) * most));
            let counts: Vec<Count> = lengths
                .iter()
                .map(|&length| {
                    let (start, end) = part(length as usize);
                    (end - start) as Count
                })
                .collect();
            let starts: Vec<Count> = counts
                .iter()
                .scan(0, |start, count| {
                    *start += count;
                    Some(*start - count)
                })
                .collect();
            let mut all = vec![0u8; counts.iter().map(|&count| count as usize).sum()];
            let (start, end) = part(message.len());
            {
                let mut partition = PartitionMut::new(&mut all[..], &counts[..], &starts[..]);
                world.all_gather_varcount_into(&message[start..end], &mut partition);
            }
            for ((message, &start), &count) in messages.iter_mut().zip(&starts).zip(&counts) {
                message.extend_from_slice(&all[start as usize..start as usize + count as usize]);
            }
        }
        messages
    }
}
