//! Faults of links: what they do to bytes and frames, and that they do it again.

use std::cell::RefCell;
use std::time::Duration;

use proptest::prelude::*;
use wimu_host::Code;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::{Decoder, Event};
use wimu_host::transport::Transport;
use wimu_host::units::RawUnits;
use wimu_link::frame::{self, Deframer, Kind, MAX_FRAME};
use wimu_link::{Batch, LinkRole, batch};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_sim::board::{Board, BoardConfig, SensorPart, SimLink};
use wimu_sim::faults::{
    Channel, Fate, FaultSpecError, Jitter, LinkFaults, Loss, Outage, PRESETS, SensorFault,
};
use wimu_sim::i2c::Target;
use wimu_sim::motion::named;
use wimu_sim::scene::{Scene, World};
use wimu_sim::source::Physics;
use wimu_sim::truth::{Gauge, SensorTruth};

/// Each second from 0 to 9: whether the sensor is there.
fn presence(spec: &str) -> [bool; 10] {
    let fault: SensorFault = spec.parse().expect("a fault");
    let board = board(BoardConfig::default());
    let mut before = None;
    std::array::from_fn(|second| {
        let now = second as u64 * 1_000_000;
        fault.apply(SensorPart::Lsm303agr, board.sensor(), before, now);
        before = Some(now);
        board.sensor().acknowledges(0x19)
    })
}

#[test]
fn a_sensor_fault_begins_and_ends_at_its_time() {
    let at = |absent: &[usize]| std::array::from_fn(|second| !absent.contains(&second));
    assert_eq!(presence("absent=2s@3s"), at(&[3, 4]));
    assert_eq!(presence("absent=1s@0s"), at(&[0]));
    assert_eq!(presence("absent=1s@1s/4s"), at(&[1, 5, 9]));
    for wrong in [
        "absent",
        "absent=3s",
        "absent=0s@3s",
        "gyroscope=1s@2s",
        "gyroscope-stops=5s@1s/4s",
        "identity=1@2s",
    ] {
        let error = wrong.parse::<SensorFault>().expect_err(wrong).to_string();
        assert!(error.contains("gyroscope-stops=3s@30s"), "{error}");
    }
}

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];
const END: u64 = u64::MAX;

fn faults(spec: &str) -> LinkFaults {
    spec.parse().expect("faults")
}

fn board(config: BoardConfig) -> Board {
    let scene = Scene::new(World::default());
    scene.play(0.0, named("rest,hand,slide", 5).expect("motions"));
    let truth = SensorTruth::random(5, Gauge::LowerTriangular);
    Board::start(config, Physics::new(truth, scene, 5))
}

fn wireless(spec: &str) -> BoardConfig {
    BoardConfig { wireless_faults: faults(spec), ..BoardConfig::default() }
}

/// What a channel makes of bytes that come 1 ms apart in pieces.
fn carried(channel: &mut Channel, bytes: &[u8], piece: usize) -> Vec<u8> {
    let mut arrived = Vec::new();
    for (index, piece) in bytes.chunks(piece).enumerate() {
        let now_ns = 1_000_000 * index as u64;
        channel.push(now_ns, piece);
        arrived.extend(channel.pull(now_ns, usize::MAX));
    }
    arrived.extend(channel.pull(END, usize::MAX));
    arrived
}

#[test]
fn faults_are_read_from_text() {
    let read = faults(
        "baud=9600, loss=2%,burst=12.5,bits=1e-4,latency=20ms,jitter=exp:50ms,\
         splice=1e-5,duplicate=0.001%,stall=3s@30s,stall=100ms@1s/2s,disconnect=5s@1min,buffer=4096",
    );
    let ms = Duration::from_millis;
    let expected = LinkFaults {
        baud: Some(9600),
        latency: ms(20),
        jitter: Some(Jitter::Exponential(ms(50))),
        loss: Some(Loss { fraction: 0.02, mean_run: 12.5 }),
        bit_error_rate: 1e-4,
        splice_rate: 1e-5,
        duplicate_rate: 1e-5,
        stalls: vec![
            Outage { start: ms(30_000), length: ms(3000), every: None },
            Outage { start: ms(1000), length: ms(100), every: Some(ms(2000)) },
        ],
        disconnects: vec![Outage { start: ms(60_000), length: ms(5000), every: None }],
        buffer: Some(4096),
        values: None,
    };
    assert_eq!(read, expected);
    let values = faults("bias=10/-5/3mg,scale=0.5%,noise=2mg").values.expect("values");
    let mg = STANDARD_GRAVITY_MPS2 * 1e-3;
    for axis in 0..3 {
        let expected = [10.0, -5.0, 3.0][axis] * mg;
        assert!((values.bias_mps2[axis] - expected).abs() < 1e-12);
    }
    assert_eq!(values.scale, [0.005; 3]);
    assert!((values.noise_mps2 - 2.0 * mg).abs() < 1e-12);
    for (name, ..) in PRESETS {
        assert_eq!(faults(name).is_none(), name == "none", "{name}");
    }
    // What follows a preset comes in its place.
    let mended = faults("noisy,bits=0,burst=5");
    assert_eq!(mended.bit_error_rate, 0.0);
    assert_eq!(mended.loss.expect("loss").mean_run, 5.0);
    assert!(faults("").is_none());
}

#[test]
fn text_that_says_no_faults_is_refused_with_what_is_expected() {
    for (spec, message) in [
        ("lossy", "`lossy` is neither a fault nor a preset"),
        ("los=2%", "`los` is neither a fault nor a preset"),
        ("loss=", "`loss=`: expected 0 to 90 % of the bytes, such as 2%"),
        ("loss=101%", "`loss=101%`"),
        ("loss=-1%", "`loss=-1%`"),
        ("loss=NaN", "`loss=NaN`"),
        ("bits=1", "`bits=1`"),
        ("baud=115200.5", "`baud=115200.5`"),
        ("baud=0", "expected 300 to 4000000"),
        ("latency=20", "a time such as 20ms"),
        ("latency=-1ms", "a time such as 20ms"),
        ("latency=infs", "a time such as 20ms"),
        ("jitter=gauss:5ms", "a time, 50ms or exp:50ms"),
        ("stall=3s", "`stall=3s`"),
        ("stall=0s@1s", "`stall=0s@1s`"),
        ("stall=3s@1s/2s", "`stall=3s@1s/2s`"),
        ("disconnect=99999h@1s", "`disconnect=99999h@1s`"),
        ("stall=6s@0s/10s,stall=6s@5s/10s", "never work"),
        ("burst=20", "there is no `loss`"),
        ("loss=1%,burst=0.5", "1 to 1000000 bytes"),
        ("splice=1", "0 to 0.1 per byte"),
        ("buffer=1", "16 to 16777216"),
        ("bias=10", "such as 10mg"),
        ("bias=1/2mg", "such as 10mg"),
        ("scale=2", "such as 0.5%"),
        ("noise=-1mg", "0 to 1000 mg"),
    ] {
        let error: FaultSpecError = spec.parse::<LinkFaults>().expect_err(spec);
        assert!(error.to_string().contains(message), "{spec}: {error}");
    }
}

#[test]
fn losses_and_bit_errors_are_as_frequent_and_as_long_as_said() {
    let spec = faults("loss=2%,burst=20,bits=1e-4");
    let mut channel = Channel::new(&spec, 3);
    // Numbers, so that lost runs can be told.
    let sent: Vec<u8> = (0..4_000_000_u32).flat_map(u32::to_be_bytes).collect();
    let arrived = carried(&mut channel, &sent, 4096);
    let counts = channel.counts();
    assert_eq!(counts.bytes_sent, sent.len() as u64);
    assert_eq!(counts.bytes_sent - counts.bytes_lost, arrived.len() as u64);
    let lost = counts.bytes_lost as f64 / counts.bytes_sent as f64;
    assert!((0.019..0.021).contains(&lost), "{lost}");
    let flipped = counts.bits_flipped as f64 / (8 * arrived.len()) as f64;
    assert!((0.97e-4..1.03e-4).contains(&flipped), "{flipped}");

    // Without errors of bits, every byte tells its place modulo 251.
    let mut channel = Channel::new(&faults("loss=2%,burst=20"), 4);
    let sent: Vec<u8> = (0..4_000_000).map(|i| (i % 251) as u8).collect();
    let arrived = carried(&mut channel, &sent, 1000);
    let runs = arrived
        .windows(2)
        .filter(|pair| (u16::from(pair[0]) + 1) % 251 != u16::from(pair[1]))
        .count();
    let mean = channel.counts().bytes_lost as f64 / runs as f64;
    assert!((18.5..21.5).contains(&mean), "{mean}");
}

proptest! {
    #[test]
    fn a_run_repeats_exactly_however_its_bytes_are_carried(
        seed in any::<u64>(),
        pieces in prop::collection::vec(1_usize..300, 1..40),
    ) {
        let spec = faults("loss=5%,burst=7,bits=1e-3,splice=2e-3,duplicate=1e-3");
        let total: usize = pieces.iter().sum();
        let sent: Vec<u8> = (0..total).map(|i| (i * 7 % 256) as u8).collect();
        let whole = carried(&mut Channel::new(&spec, seed), &sent, total);
        let mut channel = Channel::new(&spec, seed);
        let (mut arrived, mut rest) = (Vec::new(), sent.as_slice());
        for piece in pieces {
            let (now, later) = rest.split_at(piece);
            channel.push(0, now);
            arrived.extend(channel.pull(0, piece / 2));
            rest = later;
        }
        arrived.extend(channel.pull(END, usize::MAX));
        prop_assert_eq!(arrived, whole);
    }

    #[test]
    fn frames_that_the_truth_calls_intact_arrive_and_lost_ones_do_not(seed in any::<u64>()) {
        let spec = faults("loss=3%,burst=9,bits=5e-4,splice=1e-3");
        let mut channel = Channel::new(&spec, seed);
        channel.log_frames();
        let mut sent = Vec::new();
        for number in 0..400_u32 {
            let mut bytes = [0; MAX_FRAME];
            let body = [&number.to_le_bytes()[..], &[number as u8; 40]].concat();
            let length = frame::encode(Kind::Telemetry, &body, &mut bytes).unwrap();
            sent.extend_from_slice(&bytes[..length]);
        }
        let mut deframer = Deframer::new();
        let mut found = Vec::new();
        for byte in carried(&mut channel, &sent, 100) {
            if let Some(Ok(frame)) = deframer.push(byte) {
                let number = u32::from_le_bytes(*frame.body.first_chunk().unwrap());
                prop_assert_eq!(&frame.body[4..], [number as u8; 40]);
                found.push(number);
            }
        }
        let frames = channel.take_frames();
        prop_assert_eq!(frames.len(), 400);
        let intact: Vec<u32> = (0..).zip(&frames)
            .filter(|(_, frame)| frame.fate == Fate::Intact)
            .map(|(number, _)| number)
            .collect();
        prop_assert!(intact.len() > 50 && intact.len() < 400);
        // A splice may bring a whole frame again, or end with the lost beginning of one.
        prop_assert!(found.iter().all(|number| frames[*number as usize].fate != Fate::Lost));
        prop_assert!(intact.iter().all(|number| found.contains(number)));
        let counts = channel.counts();
        prop_assert_eq!(counts.frames_intact, intact.len() as u64);
        let fates = [counts.frames_intact, counts.frames_fused, counts.frames_damaged, counts.frames_lost];
        prop_assert_eq!(fates.iter().sum::<u64>(), 400);
    }
}

#[test]
fn delays_stay_within_what_was_said_and_keep_the_order() {
    let mut channel = Channel::new(&faults("latency=20ms,jitter=50ms"), 9);
    let mut latest = 0;
    let (mut least, mut most, mut sum) = (u64::MAX, 0, 0);
    for number in 0..5000_u64 {
        // 64 bytes, a packet, every 200 ms: delays do not add up.
        let sent_ns = number * 200_000_000;
        channel.push(sent_ns, &[number as u8; 64]);
        let due_ns = channel.next_arrival_ns().expect("under way");
        assert!(due_ns >= latest);
        assert_eq!(channel.pull(due_ns - 1, 100).len(), 0);
        assert_eq!(channel.pull(due_ns, 100), [number as u8; 64]);
        latest = due_ns;
        let delay = due_ns - sent_ns;
        (least, most, sum) = (least.min(delay), most.max(delay), sum + delay);
    }
    let ms = |ns: u64| ns as f64 * 1e-6;
    assert!((20.0..20.1).contains(&ms(least)), "{least}");
    assert!((69.9..=70.0).contains(&ms(most)), "{most}");
    assert!((44.0..46.0).contains(&ms(sum / 5000)), "{sum}");
}

#[test]
fn a_stall_holds_what_the_buffer_takes_and_the_rest_is_lost_and_counted() {
    let mut channel = Channel::new(&faults("stall=3s@10s/20s,buffer=100"), 1);
    let s = |seconds: f64| (seconds * 1e9) as u64;
    channel.push(s(9.9), &[1; 10]);
    assert_eq!(channel.pull(s(9.9), 99).len(), 10);
    for start in [10.0, 30.0, 50.0] {
        channel.push(s(start + 0.5), &[2; 60]);
        channel.push(s(start + 1.5), &[3; 60]);
        assert!(channel.pull(s(start + 2.999), 999).is_empty());
        assert_eq!(channel.next_arrival_ns(), Some(s(start + 3.0)));
        assert_eq!(channel.pull(s(start + 3.0), 999).len(), 100);
    }
    assert_eq!(channel.counts().bytes_overflowed, 60);
}

#[test]
fn the_same_seed_gives_the_same_run_of_a_board_and_another_one_does_not() {
    let run = |fault_seed| {
        let mut board = board(BoardConfig {
            fault_seed,
            ..wireless("noisy,disconnect=500ms@4s,duplicate=1e-4")
        });
        let mut heard = ROLES.map(|_| Vec::new());
        for step in 1..=1000 {
            board.run_until(step * 10_000);
            for (heard, role) in heard.iter_mut().zip(ROLES) {
                heard.extend(board.link(role).pull());
            }
        }
        heard
    };
    let [first, again, other] = [run(1), run(1), run(2)];
    assert_eq!(first, again);
    assert_eq!(first[0], other[0], "the cable has no faults");
    assert_ne!(first[1], other[1]);
}

#[test]
fn a_disconnected_link_says_so_and_a_new_connection_works() {
    let board = RefCell::new(board(wireless("disconnect=2s@5s")));
    let connect = || {
        let link = SimLink::new(&board, LinkRole::Wireless);
        let options = ConnectOptions { session: Some(1), ..ConnectOptions::default() };
        Client::connect(link, "the wireless link", options)
    };
    let mut client = connect().expect("a board");
    let lost = loop {
        if let Err(error) = client.next_event(Duration::from_secs(1)) {
            break error;
        }
    };
    assert_eq!(lost.code, Code::LinkLost);
    assert_eq!(board.borrow().now_us() / 1_000_000, 5);
    assert!(connect().is_err(), "there is no connection yet");
    board.borrow_mut().run_until(7_100_000);
    assert_eq!(client.next_event(Duration::ZERO).expect_err("dead").code, Code::LinkLost);
    let mut client = connect().expect("a board");
    assert!(client.status().is_ok());
    // What was said meanwhile is gone and counted.
    let board = board.borrow();
    let channels = board.faults(LinkRole::Wireless).expect("faults");
    assert!(channels.to_host.borrow().counts().bytes_disconnected > 1000);
    assert!(board.faults(LinkRole::Cable).is_none());
}

#[test]
fn values_differ_by_what_was_said_and_everything_else_is_the_cables() {
    let spec = faults("bias=12/-8/5mg,scale=0.4/-0.3/0.2%");
    let values = spec.values.expect("values");
    let mut board = board(BoardConfig { wireless_faults: spec, ..BoardConfig::default() });
    board.run_until(25_000_000);
    let mut heard = ROLES.map(|role| {
        let mut decoder = Decoder::new();
        let (mut raw, mut corrected, mut lsb_per_g) = (Vec::new(), Vec::new(), 0.0);
        decoder.push(0, &board.link(role).pull(), |arrival| match arrival.event {
            Event::Samples(samples) => match samples.stream {
                wimu_link::batch::Stream::Raw => raw.extend(samples.iter()),
                wimu_link::batch::Stream::Corrected => corrected.extend(samples.iter()),
            },
            Event::Epoch { epoch, .. } => lsb_per_g = epoch.sensitivity_lsb_per_g,
            Event::Damaged(error) => panic!("{error}"),
            _ => {}
        });
        (raw, corrected, lsb_per_g)
    });
    let (cable_raw, cable_corrected, lsb_per_g) = std::mem::take(&mut heard[0]);
    let (raw, corrected, _) = std::mem::take(&mut heard[1]);
    assert!(raw.len() > 2000 && corrected.len() > 2000);
    let mps2_per_lsb = STANDARD_GRAVITY_MPS2 / lsb_per_g;
    for (cable, wireless, mps2_per_lsb) in
        [(cable_raw, raw, mps2_per_lsb), (cable_corrected, corrected, 1.0 / 65536.0)]
    {
        for (cable, wireless) in cable.iter().zip(&wireless) {
            assert_eq!(cable.sequence, wireless.sequence);
            assert_eq!(cable.time, wireless.time);
            for axis in 0..3 {
                let f = f64::from(cable.value[axis]) * mps2_per_lsb;
                let expected = f * (1.0 + values.scale[axis]) + values.bias_mps2[axis];
                let found = f64::from(wireless.value[axis]) * mps2_per_lsb;
                assert!((found - expected).abs() <= 0.501 * mps2_per_lsb);
            }
        }
    }
}

#[test]
fn values_change_in_the_unit_of_their_range_and_leave_the_decimation() {
    let spec = faults("bias=12/-8/5mg,scale=0.4/-0.3/0.2%");
    let values = spec.values.expect("values");
    let board =
        RefCell::new(board(BoardConfig { wireless_faults: spec, ..BoardConfig::default() }));
    let link = SimLink::new(&board, LinkRole::Cable);
    let options = ConnectOptions { session: Some(1), ..ConnectOptions::default() };
    let mut client = Client::connect(link, "the cable", options).expect("a board");
    for (seconds, range_g, every) in [(4, 2, 1), (4, 8, 4), (4, 2, 3)] {
        let mut settings = client.settings().expect("settings");
        (settings.range_g, settings.wireless.every) = (range_g, every);
        client.set_settings(settings).expect("settings");
        let until_us = board.borrow().now_us() + seconds * 1_000_000;
        board.borrow_mut().run_until(until_us);
    }
    let mut cable = std::collections::BTreeMap::new();
    let mut units = RawUnits::default();
    while let Some(arrival) = client.next_event(Duration::ZERO).expect("a board") {
        match arrival.event {
            Event::Samples(samples) if samples.stream == batch::Stream::Raw => {
                cable.extend(samples.iter().map(|sample| (sample.sequence, sample.value)));
            }
            Event::Epoch { epoch, .. } => units.see(&epoch),
            _ => {}
        }
    }
    let mut compared = std::collections::BTreeMap::<(u8, bool), u32>::new();
    let wireless = board.borrow_mut().link(LinkRole::Wireless).pull();
    Decoder::new().push(0, &wireless, |arrival| {
        let Event::Samples(samples) = arrival.event else {
            return;
        };
        if samples.stream != batch::Stream::Raw {
            return;
        }
        for sample in samples.iter() {
            let (Some(cable), Some(unit)) =
                (cable.get(&sample.sequence), units.of(sample.sequence))
            else {
                continue;
            };
            for axis in 0..3 {
                let lsb = f64::from(cable[axis]) * (1.0 + values.scale[axis])
                    + values.bias_mps2[axis] / unit.mps2_per_lsb();
                assert!((f64::from(sample.value[axis]) - lsb).abs() <= 0.501, "{sample:?}");
            }
            let wide = unit.sensitivity.lsb_per_g() < 10_000.0;
            *compared.entry((samples.every, wide)).or_default() += 1;
        }
    });
    for kind in [(1, false), (4, true), (3, false)] {
        assert!(compared.get(&kind).is_some_and(|count| *count > 60), "{compared:?}");
    }
}

#[test]
fn a_clock_that_runs_fast_is_as_fast_as_said() {
    for clock_error_ppb in [-200_000, 37_000] {
        let mut board = board(BoardConfig { clock_error_ppb, ..BoardConfig::default() });
        board.run_until(60_000_000);
        let mut decoder = Decoder::new();
        let mut latest = None;
        decoder.push(0, &board.link(LinkRole::Cable).pull(), |arrival| {
            if let Event::Samples(samples) = arrival.event {
                latest = samples.iter().last().map(|sample| sample.time);
            }
        });
        // The sensor's last sample before 60 s, by the device's clock.
        let latest_s = latest.expect("samples").to_seconds();
        let expected_s = 60.0 * (1.0 + f64::from(clock_error_ppb) * 1e-9);
        assert!((-0.4..0.0).contains(&(latest_s - expected_s)), "{latest_s}");

        // Two boards, one sensor: sample for sample the clocks' ratio.
        let samples = |ppb| {
            let mut board =
                self::board(BoardConfig { clock_error_ppb: ppb, ..BoardConfig::default() });
            board.run_until(60_000_000);
            let mut times = Vec::new();
            let mut decoder = Decoder::new();
            decoder.push(0, &board.link(LinkRole::Cable).pull(), |arrival| {
                if let Event::Samples(samples) = arrival.event {
                    times.push((samples.first_sequence, samples.first_time.0 as f64));
                }
            });
            times
        };
        let (right, wrong) = (samples(0), samples(clock_error_ppb));
        let ((first_right, last_right), (first_wrong, last_wrong)) =
            ((right[0], right[right.len() - 2]), (wrong[0], wrong[right.len() - 2]));
        assert_eq!(last_right.0, last_wrong.0);
        let ratio = (last_wrong.1 - first_wrong.1) / (last_right.1 - first_right.1);
        let ppb = (ratio - 1.0) * 1e9;
        assert!((ppb - f64::from(clock_error_ppb)).abs() < 200.0, "{ppb}");
    }
}

#[test]
fn requests_and_answers_get_through_a_noisy_link() {
    let board = RefCell::new(board(wireless("noisy")));
    let link = SimLink::new(&board, LinkRole::Wireless);
    let options = ConnectOptions { session: Some(1), ..ConnectOptions::default() };
    let mut client = Client::connect(link, "the wireless link", options).expect("a board");
    let mut answered = 0;
    for _ in 0..30 {
        answered += usize::from(client.status().is_ok());
    }
    assert_eq!(answered, 30);
    assert!(client.transport().now() > Duration::from_secs(2));
}

#[test]
fn batches_with_changed_values_are_still_batches() {
    let spec = faults("bias=1000mg,scale=50%,noise=1000mg");
    let mut board = board(BoardConfig { wireless_faults: spec, ..BoardConfig::default() });
    board.run_until(15_000_000);
    let bytes = board.link(LinkRole::Wireless).pull();
    let mut deframer = Deframer::new();
    let mut batches = 0;
    for byte in bytes {
        match deframer.push(byte) {
            Some(Ok(frame)) if frame.kind == Kind::Batch => {
                Batch::decode(frame.kind, frame.body).expect("a batch");
                batches += 1;
            }
            Some(Err(error)) => panic!("{error}"),
            _ => {}
        }
    }
    assert!(batches > 150, "{batches}");
}
