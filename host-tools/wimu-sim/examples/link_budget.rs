//! What raw samples cost on a whole link of a whole board, epochs and everything else included.

use std::cell::RefCell;
use std::time::Duration;

use wimu_host::client::{Client, ConnectOptions};
use wimu_host::transport::Transport;
use wimu_link::LinkRole;
use wimu_link::auth::DeviceKey;
use wimu_link::message::{Settings, Streams};
use wimu_sim::board::{Board, BoardConfig, SimLink};
use wimu_sim::motion;
use wimu_sim::pipe::LinkConfig;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};
use wimu_testkit::figure;

const SECONDS: u64 = 30;
const KEY: DeviceKey = DeviceKey::new([7; 32]);

fn main() -> wimu_host::Result<()> {
    println!(
        "a simulated LSM303AGR (12 bits, noise of the real part), raw samples in batches of 16,"
    );
    println!("all bytes on the wire over {SECONDS} s: batches, epochs, status");
    println!("{:8} {:>6} {:>10} {:>18}", "motion", "Hz", "B/sample", "Hz at 115200 baud");
    for motion in ["rest", "hand"] {
        let mut all = Vec::new();
        let mut tags = Vec::new();
        for rate_hz in [100, 400, 1344] {
            let bytes = bytes_per_sample(motion, rate_hz, None)?;
            let tagged = bytes_per_sample(motion, rate_hz, Some(KEY))?;
            tags.push(format!("{:.3}", tagged - bytes));
            println!("{motion:8} {rate_hz:6} {bytes:10.3} {:18.0}", 11_520.0 / bytes);
            all.push(format!("{bytes:.2}"));
        }
        let claim = format!("whole link, {motion}, 100, 400, 1344 Hz: bytes a sample");
        figure(&claim, all.join(" / "), "–", true);
        let claim = format!("authentication, {motion}, 100, 400, 1344 Hz: bytes a sample more");
        figure(&claim, tags.join(" / "), "–", true);
    }
    Ok(())
}

fn bytes_per_sample(name: &str, rate_hz: u16, key: Option<DeviceKey>) -> wimu_host::Result<f64> {
    let scene = Scene::new(World::default());
    let truth = SensorTruth::random(1, Gauge::Full);
    let config = BoardConfig {
        cable: LinkConfig::default(),
        wireless: LinkConfig::default(),
        ..BoardConfig::default()
    };
    let board = RefCell::new(Board::start(config, Physics::new(truth, scene.clone(), 1)));
    let link = SimLink::new(&board, LinkRole::Cable);
    let mut client = Client::connect(link, "the cable", ConnectOptions::default())?;
    if let Some(key) = key {
        client.set_key(key)?;
    }
    let settings = client.settings()?;
    client.set_settings(Settings {
        range_g: 4,
        rate_hz,
        cable: Streams {
            corrected: false,
            navigation: false,
            environment: false,
            ..settings.cable
        },
        ..settings
    })?;
    if let Ok(played) = motion::named(name, 1)
        && name != "rest"
    {
        scene.play(client.transport().now().as_secs_f64(), played);
    }
    while client.next_event(Duration::ZERO)?.is_some() {}
    let before = client.statistics();
    let end = client.transport().now() + Duration::from_secs(SECONDS);
    while client.transport().now() < end {
        client.next_event(Duration::from_millis(10))?;
    }
    let after = client.statistics();
    Ok((after.bytes - before.bytes) as f64 / (after.raw.received - before.raw.received) as f64)
}
