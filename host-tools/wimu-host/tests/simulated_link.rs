//! Sessions over a simulated link: what it does to transfers, and what a clock estimator hears.

use std::collections::VecDeque;
use std::time::Duration;

use wimu_host::clock::{ClockEstimator, ClockModel, Pace, Trip};
use wimu_host::decode::{Arrival, Event, Samples};
use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Answer, Command, Payload, Reply, Request, Signature};
use wimu_model::{DeviceTimeUs, PeriodNs};
use wimu_testkit::Random;

use crate::common::frames::framed;

/// What a link does to transfers.
#[derive(Clone, Copy, Debug)]
pub enum Jitter {
    /// Up to so much, ns.
    Uniform(f64),
    /// With this mean, ns.
    Exponential(f64),
    /// The sum of two exponential ones with this mean each, ns: none of them is short.
    Gamma(f64),
    /// The size of a normal one with this standard deviation, ns.
    HalfNormal(f64),
    /// None, but for every tenth: up to so much, ns.
    Rare(f64),
    /// Uniform, up to so much, ns, and seven times in ten the one before again, to 1 ms.
    Lasting(f64),
}

impl Jitter {
    /// The next delay of a direction, ns, after `last`.
    fn draw(self, random: &mut Random, last: &mut f64) -> f64 {
        let mut exponential = || -(1.0 - random.uniform()).ln();
        match self {
            Self::Exponential(mean) => mean * exponential(),
            Self::Gamma(mean) => mean * (exponential() + exponential()),
            Self::HalfNormal(sd) => {
                let length = (2.0 * exponential()).sqrt();
                sd * length * (std::f64::consts::TAU * random.uniform()).cos().abs()
            }
            Self::Uniform(most) => most * random.uniform(),
            Self::Rare(most) => {
                let late = random.uniform() < 0.1;
                f64::from(u8::from(late)) * most * random.uniform()
            }
            Self::Lasting(most) => {
                if random.uniform() < 0.3 || *last == 0.0 {
                    *last = most * random.uniform();
                }
                *last + 1e6 * random.uniform()
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Link {
    pub jitter: Jitter,
    /// Least time towards the host, and towards the device, ns.
    pub least: [f64; 2],
    /// By how much these grow over the session, ns.
    pub creep: [f64; 2],
    /// ns a byte.
    pub byte: f64,
    pub rate_ppm: f64,
    pub duration_s: f64,
    /// By how many ppm the rate grows in an hour.
    pub wander_ppm_h: f64,
    /// Whether questions are asked at all.
    pub asks: bool,
}

impl Default for Link {
    /// The bar's link: 115,200 baud, up to 50 ms of jitter, a slow device.
    fn default() -> Self {
        Self {
            jitter: Jitter::Uniform(50e6),
            least: [15e6, 15e6],
            creep: [0.0; 2],
            byte: 1e10 / 115_200.0,
            rate_ppm: 37.0,
            duration_s: 60.0,
            wander_ppm_h: 0.0,
            asks: true,
        }
    }
}

const START_NS: f64 = 5e12;

/// Bytes that share a delay at most, and the pause on the line after which others have another.
const PACKET: u64 = 64;

const PAUSE_NS: f64 = 3e6;

/// The part of the frames lost, of questions and answers and of batches: 2 % of the bytes in runs
/// of 20, and 10⁻⁴ of the bits.
const SHORT_LOST: f64 = 0.06;

const LONG_LOST: f64 = 0.125;

/// Length of a question and of its answer, bytes.
pub const QUESTION: f64 = 22.0;

impl Link {
    /// Host time of a device time, ns.
    pub fn truth(&self, device_s: f64) -> f64 {
        let drift = self.wander_ppm_h * device_s * device_s / 7200.0;
        START_NS + device_s * 1e9 + (self.rate_ppm * device_s + drift) * 1e3
    }

    /// The least time of a direction, ns.
    fn takes(&self, direction: usize, device_s: f64) -> f64 {
        self.least[direction] + self.creep[direction] * device_s / self.duration_s
    }

    /// An estimator after a session: batches of 16 at 100 Hz and what travels beside them, all in
    /// order, some of the frames lost, longer ones in the second half, a stall of 3 s.
    pub fn session(&self, seed: u64) -> ClockEstimator {
        let mut clock = ClockEstimator::new();
        self.play(1, seed, &mut clock);
        clock
    }

    pub fn play(&self, number: usize, seed: u64, clock: &mut ClockEstimator) {
        let mut random = Random::new(seed * 1000 + 1);
        let mut other = Random::new(seed * 1000 + 2);
        // When it is ready by the device's clock, what it is, bytes, when it was asked for.
        let mut frames = Vec::new();
        for (every, class, bytes) in [(0.16, Some(Sent::Raw), 45.0), (0.1, None, 50.0)] {
            let mut time = every;
            while time < self.duration_s {
                let long = match class {
                    Some(_) if time > self.duration_s / 2.0 => 25.0,
                    _ => 0.0,
                };
                let bytes = bytes + long + (10.0 * other.uniform()).floor();
                frames.push((time, class, bytes, 0.0));
                time += every;
            }
        }
        let mut pace = Pace::default();
        let stall = (self.truth(40.0), self.truth(43.0));
        let stalled = |at: f64| {
            if (stall.0..stall.1).contains(&at) { stall.1 } else { at }
        };
        let (mut time, mut line_free, mut heard) = (0.03, 0.0_f64, 0.0_f64);
        // Of each answer when it comes and how long it took: about, the line is free.
        let mut answers = VecDeque::new();
        let mut lasts = [0.0; 2];
        while self.asks && time < self.duration_s {
            let now = Duration::from_secs_f64(time);
            while let Some(&(at, trip)) = answers.front().filter(|(at, _)| *at <= now) {
                answers.pop_front();
                pace.answered(at, answered(trip));
            }
            if !pace.is_due(now) {
                time += 0.001 * (0.5 + other.uniform());
                continue;
            }
            pace.asked(now);
            let asked = self.truth(time);
            line_free = line_free.max(asked) + self.byte * QUESTION;
            let late = self.jitter.draw(&mut random, &mut lasts[0]);
            // One after the other.
            heard = (heard + 1e3).max(stalled(line_free + self.takes(1, time) + late));
            let heard_s = time + (heard - asked) * 1e-9;
            if other.uniform() >= SHORT_LOST {
                frames.push((heard_s, Some(Sent::Answer), QUESTION, asked));
                let back = self.least[0] + self.jitter.draw(&mut other, &mut 0.0);
                let trip = (heard - asked + back + self.byte * QUESTION) * 1e-9;
                answers.push_back((
                    Duration::from_secs_f64(time + trip),
                    Duration::from_secs_f64(trip),
                ));
            }
        }
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut arrived, mut line_free, mut packet) = (0.0_f64, 0.0_f64, PACKET);
        let mut late = 0.0;
        for (index, (ready_s, class, bytes, asked)) in (0..).zip(frames) {
            let ready = self.truth(ready_s);
            if ready > line_free + PAUSE_NS {
                packet = PACKET;
            }
            line_free = line_free.max(ready);
            let mut began = None;
            for _ in 0..bytes as u64 {
                if packet == PACKET {
                    late = self.jitter.draw(&mut random, &mut lasts[1]);
                    packet = 0;
                }
                packet += 1;
                line_free += self.byte;
                arrived = arrived.max(stalled(line_free + self.takes(0, ready_s) + late));
                began.get_or_insert(arrived);
            }
            let lost = match class {
                Some(Sent::Answer) => SHORT_LOST,
                _ => LONG_LOST,
            };
            let uptime_us = (ready_s * 1e6).round() as u64;
            let event = match class.filter(|_| other.uniform() >= lost) {
                // Something else, or damaged.
                None => Event::Unreadable(String::new()),
                Some(Sent::Raw) => raw(uptime_us),
                Some(Sent::Answer) => {
                    answer(clock, (number as u32, index), asked as u64, uptime_us)
                }
            };
            let began_ns = began.unwrap_or(arrived) as u64;
            clock.heard(role(number), &Arrival { host_ns: arrived as u64, began_ns, event });
        }
    }

    /// A cable: a tenth of a millisecond, jitter as much.
    pub fn cable() -> Self {
        Self { jitter: Jitter::Exponential(1e5), least: [1e5, 1e5], ..Self::default() }
    }

    pub fn middle(&self) -> DeviceTimeUs {
        DeviceTimeUs((self.duration_s * 5e5) as u64)
    }

    /// Model less truth in the middle, ns.
    pub fn error(&self, model: &ClockModel) -> f64 {
        model.host_ns(self.middle()) as f64 - self.truth(self.duration_s / 2.0)
    }
}

/// What travels over a link: batches and answers.
#[derive(Clone, Copy)]
enum Sent {
    Raw,
    Answer,
}

fn role(link: usize) -> LinkRole {
    [LinkRole::Cable, LinkRole::Wireless][link]
}

/// A batch whose last sample was taken at this time.
pub fn raw(time_us: u64) -> Event {
    Event::Samples(Samples {
        sensor: 0,
        rates: Vec::new(),
        stream: Stream::Raw,
        first_sequence: 0,
        first_time: DeviceTimeUs(time_us),
        period: PeriodNs(10_000_000),
        every: 1,
        values: vec![[0; 3]],
    })
}

/// An answer to a time request of this number that was sent at `asked_ns` and is as long.
pub fn answer(
    clock: &mut ClockEstimator,
    (session, id): (u32, u32),
    asked_ns: u64,
    uptime_us: u64,
) -> Event {
    let command = Command::GetTime;
    let request: Request = Request { session, id, signature: Signature::NONE, command };
    let request = framed(|frame| request.encode(frame));
    let answer = Answer::Accepted(Payload::Time { uptime_us });
    let reply: Reply = Reply { session, id, signature: Signature::NONE, answer };
    let length = framed(|frame| reply.encode(frame)).len();
    let mut question = vec![0; length.saturating_sub(request.len())];
    question.extend(request);
    clock.asked(asked_ns, &question);
    Event::Reply { reply, body: Vec::new() }
}

/// A trip of which the line shows nothing else.
pub fn answered(whole: Duration) -> Trip {
    let on_line = None;
    Trip { whole, on_line }
}
