//! Ranks that are threads of one process, for tests: what holds for them holds for processes, and no MPI is needed.

use super::Ranks;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};

struct Member {
    rank: usize,
    to: Vec<Sender<Vec<u8>>>,
    from: Vec<Mutex<Receiver<Vec<u8>>>>,
}

/// Runs `work` on `count` ranks; the results are in their order. Each rank has a pool of one thread, as `--mpi` gives it for a build.
pub fn on_ranks<T: Send>(count: usize, work: impl Fn(&dyn Ranks) -> T + Sync) -> Vec<T> {
    let mut senders: Vec<Vec<Sender<Vec<u8>>>> = (0..count).map(|_| Vec::new()).collect();
    let mut receivers: Vec<Vec<Mutex<Receiver<Vec<u8>>>>> = (0..count).map(|_| Vec::new()).collect();
    for from in &mut senders {
        for to in &mut receivers {
            let (sender, receiver) = channel();
            from.push(sender);
            to.push(Mutex::new(receiver));
        }
    }
    let members = senders.into_iter().zip(receivers).enumerate();
    std::thread::scope(|scope| {
        let threads: Vec<_> = members
            .map(|(rank, (to, from))| {
                let member = Member { rank, to, from };
                scope.spawn(|| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
                    let member = member;
                    pool.install(|| work(&member))
                })
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

impl Ranks for Member {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.to.len()
    }

    fn send(&self, to: usize, message: &[u8]) {
        self.to[to].send(message.to_vec()).unwrap();
    }

    fn receive(&self, from: usize) -> Vec<u8> {
        self.from[from].lock().unwrap().recv().unwrap()
    }

    fn sum(&self, values: &mut [u64]) {
        let all = self.exchange(bytemuck::cast_slice(values));
        values.fill(0);
        for message in all {
            let more: Vec<u64> = bytemuck::pod_collect_to_vec(&message);
            assert_eq!(more.len(), values.len(), "ranks disagree about what they add up");
            values.iter_mut().zip(more).for_each(|(sum, value)| *sum += value);
        }
    }

    fn exchange(&self, message: &[u8]) -> Vec<Vec<u8>> {
        (0..self.count()).for_each(|to| self.send(to, message));
        (0..self.count()).map(|from| self.receive(from)).collect()
    }
}
