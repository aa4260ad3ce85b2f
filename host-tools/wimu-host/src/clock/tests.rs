use super::*;

/// What a link does to transfers.
#[derive(Clone, Copy, Debug)]
enum Jitter {
    /// Up to so much, ns.
    Uniform(f64),
    /// With this mean, ns.
    Exponential(f64),
}

#[derive(Clone, Copy, Debug)]
struct Link {
    jitter: Jitter,
    /// Least time towards the host, and towards the device, ns.
    least: [f64; 2],
    /// ns a byte.
    byte: f64,
    rate_ppm: f64,
    /// Seconds without questions after one.
    ask_every_s: f64,
    duration_s: f64,
    /// By how many ppm the rate grows in an hour.
    wander_ppm_h: f64,
    /// Whether questions are asked at all.
    asks: bool,
}

impl Default for Link {
    /// The bar's link: 115,200 baud, up to 50 ms of jitter, a slow device.
    fn default() -> Self {
        Self {
            jitter: Jitter::Uniform(50e6),
            least: [20e6, 20e6],
            byte: 1e10 / 115_200.0,
            rate_ppm: 37.0,
            ask_every_s: 0.2,
            duration_s: 60.0,
            wander_ppm_h: 0.0,
            asks: true,
        }
    }
}

struct Random(u64);

impl Random {
    /// Uniform in 0..1, by SplitMix64.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

const START_NS: f64 = 5e12;

impl Link {
    /// Host time of a device time, ns.
    fn truth(&self, device_s: f64) -> f64 {
        let drift = self.wander_ppm_h * device_s * device_s / 7200.0;
        START_NS + device_s * 1e9 + (self.rate_ppm * device_s + drift) * 1e3
    }

    /// An estimator after a session: batches of 16 at 100 Hz in order, a fifth of the frames
    /// lost, longer ones in the second half, a stall of 3 s.
    fn session(&self, seed: u64) -> ClockEstimator {
        let mut clock = ClockEstimator::new();
        self.play(1, seed, &mut clock);
        clock
    }

    fn play(&self, number: usize, seed: u64, clock: &mut ClockEstimator) {
        let mut random = Random(seed * 1000 + 1);
        let mut jitter = || match self.jitter {
            Jitter::Uniform(most) => most * random.next(),
            Jitter::Exponential(mean) => -mean * (1.0 - random.next()).ln(),
        };
        let mut lost = Random(seed * 1000 + 2);
        // (device time it is ready, class, bytes, asked).
        let mut frames = Vec::new();
        let mut time = 0.16;
        while time < self.duration_s {
            let long = if time > self.duration_s / 2.0 {
                25.0
            } else {
                0.0
            };
            frames.push((
                time,
                Class::Raw,
                45.0 + long + (10.0 * lost.next()).floor(),
                0.0,
            ));
            time += 0.16;
        }
        let mut time = 0.03;
        while self.asks && time < self.duration_s {
            let bytes = 62.0;
            let asked = self.truth(time);
            let heard = asked + self.least[1] + self.byte * 62.0 + jitter();
            let heard_s = time + (heard - asked) * 1e-9;
            frames.push((heard_s, Class::Answer, bytes, asked));
            time += self.ask_every_s;
        }
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut arrived = 0.0_f64;
        let mut line_free = 0.0_f64;
        for (ready_s, class, bytes, asked) in frames {
            let ready = self.truth(ready_s);
            line_free = line_free.max(ready) + self.byte * bytes;
            let mut at = line_free + self.least[0] + jitter();
            let stall = (self.truth(40.0), self.truth(43.0));
            if (stall.0..stall.1).contains(&at) {
                at = stall.1;
            }
            arrived = arrived.max(at);
            if lost.next() < 0.2 {
                continue;
            }
            let time = DeviceTimeUs((ready_s * 1e6).round() as u64);
            if class == Class::Answer {
                let began = arrived - self.byte * bytes;
                clock.transfer(number, Class::AnswerBegins, time, began as u64);
                clock.transfer(number, Class::Question, time, asked as u64);
            }
            clock.transfer(
                number,
                class,
                time,
                (arrived
                    - if class == Class::Raw {
                        self.byte * bytes
                    } else {
                        0.0
                    }) as u64,
            );
            if class == Class::Answer {
                clock.exchanges += 1;
            }
        }
    }

    /// A cable: a tenth of a millisecond, jitter as much.
    fn cable() -> Self {
        Self {
            jitter: Jitter::Exponential(1e5),
            least: [1e5, 1e5],
            ..Self::default()
        }
    }

    fn middle(&self) -> DeviceTimeUs {
        DeviceTimeUs((self.duration_s * 5e5) as u64)
    }

    /// Model less truth in the middle, ns.
    fn error(&self, model: &ClockModel) -> f64 {
        model.host_ns(self.middle()) as f64 - self.truth(self.duration_s / 2.0)
    }
}

#[test]
fn after_a_minute_the_offset_is_known_within_a_millisecond_on_a_bad_link() {
    for jitter in [Jitter::Uniform(50e6), Jitter::Exponential(20e6)] {
        let link = Link {
            jitter,
            ask_every_s: 0.1,
            ..Link::default()
        };
        for seed in 0..20 {
            let error = link.error(&link.session(seed).model().unwrap());
            assert!(error.abs() < 1e6, "{jitter:?} {seed}: {error} ns");
        }
    }
}

#[test]
fn the_cable_tells_the_rate_that_the_wireless_link_has_not_told_yet() {
    for seed in 0..20 {
        let mut clock = ClockEstimator::new();
        Link::cable().play(0, seed + 100, &mut clock);
        Link::default().play(1, seed, &mut clock);
        let model = clock.model().unwrap();
        let (rate, sd) = model.rate_ppm();
        assert!((rate - 37.0).abs() < 2.0, "{seed}: {rate} ± {sd}");
        let error = Link::default().error(&model);
        assert!(error.abs() < 1e5, "{seed}: {error} ns");
    }
}

#[test]
fn two_standard_deviations_hold_the_truth_nine_times_of_ten() {
    let links = [
        Link::default(),
        Link::cable(),
        Link {
            jitter: Jitter::Exponential(50e6),
            ..Link::default()
        },
        Link {
            duration_s: 300.0,
            ..Link::default()
        },
    ];
    for link in links {
        let (mut offsets, mut rates) = (0, 0);
        for seed in 0..40 {
            let model = link.session(seed).model().unwrap();
            let (rate, rate_sd) = model.rate_ppm();
            offsets += u32::from(link.error(&model).abs() <= 2.0 * model.sd_ns(link.middle()));
            rates += u32::from((rate - link.rate_ppm).abs() <= 2.0 * rate_sd);
        }
        println!("{link:?}: of 40 offsets {offsets} covered, of 40 rates {rates}");
        assert!(offsets >= 36 && rates >= 35, "{link:?}: {offsets}, {rates}");
    }
}

#[test]
fn directions_that_differ_shift_the_middle_and_stay_within_the_bounds() {
    let link = Link {
        jitter: Jitter::Exponential(5e6),
        least: [35e6, 5e6],
        ..Link::default()
    };
    let model = link.session(1).model().unwrap();
    // 30 ms more towards the host than towards the device look like 15 ms of clock.
    let error = link.error(&model);
    assert!((error - 15e6).abs() < 1e6, "{error}");
    let (before, behind) = model.bounds_ns(link.middle());
    assert!(before.unwrap() > error && behind > -error);
    assert!(model.summary().offset_bound_ms.unwrap() < 30.0);
}

#[test]
fn without_questions_times_are_late_by_the_fastest_transfer_and_say_so() {
    let link = Link {
        asks: false,
        jitter: Jitter::Exponential(5e6),
        duration_s: 600.0,
        ..Link::default()
    };
    let model = link.session(1).model().unwrap();
    assert_eq!(model.bounds_ns(link.middle()).0, None);
    assert_eq!(model.summary().offset_bound_ms, None);
    let error = link.error(&model);
    assert!((20e6..26e6).contains(&error), "{error}");
    assert!((model.rate_ppm().0 - 37.0).abs() < 2.0);
}

#[test]
fn a_wandering_clock_is_followed_for_days_in_bounded_memory() {
    let link = Link {
        duration_s: 7200.0,
        wander_ppm_h: 2.0,
        ..Link::cable()
    };
    let clock = link.session(1);
    assert!(clock.closed.len() <= 2 * REACH + 1);
    assert!(clock.lines.len() <= 7200 / BLOCK_S as usize + 1);
    let held: usize = clock.closed.iter().map(Folded::points).sum();
    assert!(held < 9 * 1000, "{held} of {} transfers", clock.transfers);
    let model = clock.model().unwrap();
    for second in (60..7140).step_by(60) {
        let time = DeviceTimeUs(second * 1_000_000);
        let error = model.host_ns(time) as f64 - link.truth(second as f64);
        assert!(error.abs() < 1e5, "{second} s: {error} ns");
    }
    // One line under all of it would be 1.8 ms off at the ends and in the middle.
}

#[test]
fn little_gives_a_wide_answer_and_nothing_gives_none() {
    assert!(ClockEstimator::new().model().is_none());
    let mut clock = ClockEstimator::new();
    clock.transfer(0, Class::Raw, DeviceTimeUs(500), 7_000_000);
    let model = clock.model().unwrap();
    assert_eq!(model.host_ns(DeviceTimeUs(500)), 7_000_000);
    assert_eq!(model.host_ns(DeviceTimeUs(0)), 6_500_000);
    assert!(model.rate_ppm().1 >= 10_000.0);
    // The ends of what 64 bits hold.
    clock.transfer(1, Class::Answer, DeviceTimeUs(u64::MAX), 0);
    clock.transfer(1, Class::Question, DeviceTimeUs(0), u64::MAX);
    let _ = clock.model().unwrap().host_ns(DeviceTimeUs(u64::MAX / 2));
}
