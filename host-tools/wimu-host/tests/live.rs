//! Links in threads of their own: what is decoded reaches who listens.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use wimu_host::client::{Client, ConnectOptions};
use wimu_host::clock::Pace;
use wimu_host::decode::Event;
use wimu_host::live::{Heard, LiveLinks, Tap};
use wimu_host::transport::Transport;
use wimu_host::{LinkUrl, Result};
use wimu_link::{Hello, LinkRole, MAX_FRAME, batch};
use wimu_model::{Counts, DeviceTimeUs};

/// Batches of the burst, and samples of each.
const BATCHES: u32 = 60;
const BATCH: u32 = 16;

/// A link that identifies itself, then gives many batches in one read, and nothing more. Its clock advances by 15 ms
/// whenever it is read: a slow computer.
struct Burst {
    now_ms: AtomicU64,
    reads: VecDeque<Vec<u8>>,
}

impl Burst {
    fn new() -> Self {
        let mut frame = [0; MAX_FRAME];
        let length = Hello::new(LinkRole::Cable).encode(&mut frame).unwrap();
        let hello = frame[..length].to_vec();
        let mut burst = Vec::new();
        for number in 0..BATCHES {
            let first = number * BATCH;
            let time = DeviceTimeUs(u64::from(first) * 10_000);
            let samples = [Counts([0, 0, 16_384]); BATCH as usize];
            let length = batch::encode(first, time, &samples, &mut frame).unwrap();
            burst.extend_from_slice(&frame[..length]);
        }
        assert!(burst.len() < 4096, "one read");
        Self { now_ms: AtomicU64::new(0), reads: [hello, burst].into() }
    }
}

impl Transport for Burst {
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> Result<usize> {
        let Some(bytes) = self.reads.pop_front() else {
            return Ok(0);
        };
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn write_all(&mut self, _: &[u8]) -> Result<()> {
        Ok(())
    }

    fn now(&self) -> Duration {
        Duration::from_millis(self.now_ms.fetch_add(15, Ordering::Relaxed))
    }
}

fn samples(heard: &Heard) -> usize {
    let arrivals = heard.arrivals.iter();
    arrivals
        .map(|arrival| match &arrival.event {
            Event::Samples(samples) => samples.iter().count(),
            _ => 0,
        })
        .sum()
}

#[test]
fn every_sample_of_a_burst_is_passed_on() {
    for stop_at in [usize::MAX, 1] {
        let link: Box<dyn Transport + Send> = Box::new(Burst::new());
        let client = Client::connect(link, "burst", ConnectOptions::default()).unwrap();
        let url: LinkUrl = "tcp://127.0.0.1:1".parse().unwrap();
        let links = LiveLinks::start(vec![(url, client.map_transport(Tap::on))], Pace::sparse);
        let all = (BATCHES * BATCH) as usize;
        let (mut found, until) = (0, Instant::now() + Duration::from_secs(60));
        while found < all.min(stop_at) && Instant::now() < until {
            match links.next(Duration::from_millis(100)) {
                Ok((_, heard)) => found += samples(&heard),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        // Those that wait when it is stopped are passed on, too.
        links.finish(|_, heard| found += samples(heard));
        assert_eq!(found, all);
    }
}
