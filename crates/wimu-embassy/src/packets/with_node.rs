//! A node whose wireless link is a [`PacketLink`].

use core::sync::atomic::{AtomicU64, Ordering};
use std::vec::Vec;

use embassy_futures::block_on;
use embassy_futures::join::join3;
use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use wimu_link::frame::Deframer;
use wimu_link::hello::{Capabilities, Part};
use wimu_link::{Hello, Kind, LinkRole};
use wimu_model::{Counts, DeviceTimeUs};
use wimu_node::sensor::{AccelerometerScale, Batch, Plan, SensorFault, Surroundings};
use wimu_node::{Board, InertialSensor, Key, PolledPlanner, Shared, Store, StoreFault, Timer};

use super::*;
use crate::{Start, hello};

/// A clock that advances by 1 ms whenever it is read.
#[derive(Clone)]
struct Clock;

static NOW_US: AtomicU64 = AtomicU64::new(0);

impl Timer for Clock {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(NOW_US.fetch_add(1000, Ordering::Relaxed))
    }

    async fn until(&self, moment: DeviceTimeUs) {
        while self.now().0 < moment.0 {
            yield_now().await;
        }
    }
}

pub(crate) struct NoSensor;

static SCALE: AccelerometerScale = AccelerometerScale::of(16384.0);

impl InertialSensor for NoSensor {
    type Sample = Counts;
    type Planner = PolledPlanner;
    const PART: Part = Part::new(0, "none");

    fn planner(&self) -> PolledPlanner {
        let (accelerometer, full_scale) = (&SCALE, i16::MAX.into());
        PolledPlanner { range_g: 2, fastest_hz: 100, accelerometer, full_scale, gyroscope: None }
    }

    async fn configure(&mut self, _: &Plan) -> Result<(), SensorFault> {
        Ok(())
    }

    async fn next(&mut self, _: &mut [Counts]) -> Result<Batch, SensorFault> {
        Err(SensorFault::NoData)
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        Ok(Surroundings::default())
    }
}

struct NoStore;

impl Store for NoStore {
    fn load(&mut self, _: Key, _: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        Ok(None)
    }

    async fn save(&mut self, _: Key, _: &[u8]) -> Result<(), StoreFault> {
        Ok(())
    }

    async fn count_start(&mut self) -> Result<u32, StoreFault> {
        Ok(1)
    }

    async fn remove(&mut self, _: fn(Key) -> bool) -> Result<(), StoreFault> {
        Ok(())
    }
}

/// Listens as a host over connections of `most` bytes a packet, until a Hello comes: the frames before it, and whether one
/// of them was damaged.
async fn until_hello(link: &PacketLink, most: usize) -> (Hello, usize) {
    let mut deframer = Deframer::new();
    let mut damaged = 0;
    loop {
        let mut packet = std::vec![0; most];
        let length = link.next_packet(&mut packet).await;
        for byte in &packet[..length] {
            match deframer.push(*byte) {
                Some(Ok(frame)) if frame.kind == Kind::Hello => {
                    return (Hello::decode(frame.body).unwrap(), damaged);
                }
                Some(Err(_)) => damaged += 1,
                _ => {}
            }
        }
    }
}

#[test]
fn each_host_that_connects_gets_a_hello_of_the_wireless_link_and_no_damaged_frame() {
    let (wireless, cable) = (PacketLink::new(), PacketLink::new());
    let (start, part) = (Start::default(), Part::default());
    let identity = hello::<NoSensor>(7, "1.2.3", &start, Capabilities::STORE, part);
    let board = Board {
        hello: identity,
        sensor: NoSensor,
        timer: Clock,
        store: NoStore,
        entropy: [0; 16],
        cable: cable.split(),
        wireless: wireless.split(),
        nearest_rate: None,
    };
    let shared = Shared::<Mutex, Counts>::new();
    let mut node = board.split(&shared);
    let device = join3(node.control.run(), node.wireless_reader.run(), node.wireless_writer.run());
    let hosts = async {
        let mut found = Vec::new();
        for most in [20, 244, 20] {
            wireless.connect();
            found.push(until_hello(&wireless, most).await);
            // It takes a part of what follows, and is gone: within a frame.
            let mut rest = [0; 7];
            wireless.next_packet(&mut rest).await;
            wireless.disconnect();
            Clock.after_us(300_000).await;
        }
        found
    };
    // A node runs for ever.
    let Either::Second(found) = block_on(select(device, hosts));
    for (hello, damaged) in found {
        assert_eq!((hello.device_id, hello.role), (7, LinkRole::Wireless));
        assert_eq!(damaged, 0);
    }
    assert!(wireless.dropped() > 0);
}
