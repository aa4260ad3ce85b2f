//! The third reading: residuals under the fit, and the error of resampling by the time of
//! arrival.

use std::io::Read;

use super::arrival::{ArrivalUser, ByArrival};
use super::counted::{Counted, Differences};
use super::model::LinkModel;
use super::overview::Overview;
use super::pairing::Pairing;
use super::{in_order, index_of};
use crate::Result;
use crate::decode::{Event, TimedSample};
use crate::mcap_file::{Recorded, RecordingReader};
use crate::walk::{Step, walk};

/// Result of the third reading.
pub(super) struct Residual {
    pub after: Differences,
    /// By link: by time of arrival, and with its median latency subtracted.
    users: [[ArrivalUser; 2]; 2],
}

impl Residual {
    pub fn read<R: Read>(
        mut reader: RecordingReader<R>,
        overview: &Overview,
        counted: &Counted,
        model: Option<&LinkModel>,
    ) -> Result<Self> {
        let users = |link: usize| {
            let latency_ns: f64 = counted.meters[link].median_latency_ns();
            [ArrivalUser::new(0.0), ArrivalUser::new(latency_ns)]
        };
        let mut residual = Self { after: Differences::default(), users: [users(0), users(1)] };
        let mut pairing = Pairing::new(overview.heard, &overview.holes);
        let mut current = [None; 2];
        walk(&mut reader, |role, start, step| {
            let link = index_of(role);
            let arrival = match step {
                Step::Arrival(arrival) => arrival,
                Step::Other(Recorded::Damaged { .. }) => {
                    current[link] = None;
                    return Ok(());
                }
                _ => return Ok(()),
            };
            let (samples, is_late) = match &arrival.event {
                Event::Samples(samples) if overview.is_compared(samples) => (samples, false),
                Event::Late(samples) if overview.is_compared(samples) => (samples, true),
                _ => return Ok(()),
            };
            let Some(clock) = overview.clock(start) else {
                return Ok(());
            };
            let unit = |sample: &TimedSample| overview.unit(start, sample.sequence);
            let new = current[link].replace(start) != Some(start);
            let count = samples.values.len();
            // Late samples are of no use by time of arrival.
            for user in residual.users[link].iter_mut().filter(|_| !is_late) {
                if new {
                    user.restart();
                }
                for (index, sample) in samples.iter().enumerate() {
                    let Some(unit) = unit(&sample) else {
                        user.restart();
                        continue;
                    };
                    // A batch arrives at once; its samples are spaced by their period before its end.
                    let apart_ns = u64::from(samples.period.0) * u64::from(samples.every);
                    let before_ns = (count - 1 - index) as u64 * apart_ns;
                    let arrived_ns = arrival.host_ns.wrapping_sub(before_ns);
                    let value = unit.mps2(sample.value);
                    user.take(clock.host_ns(sample.time), arrived_ns, value);
                }
            }
            let Some(model) = model else {
                return Ok(());
            };
            for sample in samples.iter() {
                let twin = pairing.pair(link, start, &sample, samples.every, is_late, clock);
                if let Some((twin, _)) = twin {
                    let [cable, wireless] = in_order(link, sample.value, twin);
                    let Some(unit) = unit(&sample) else {
                        continue;
                    };
                    if unit.is_saturated(cable) || unit.is_saturated(wireless) {
                        continue;
                    }
                    let corrected = model.correct_lsb(wireless, unit.mps2_per_lsb());
                    residual.after.take(cable, corrected, unit.mps2_per_lsb());
                }
            }
            Ok(())
        })?;
        Ok(residual)
    }

    pub fn by_arrival(&self, link: usize) -> ByArrival {
        let [as_it_arrives, without_latency] = &self.users[link];
        ByArrival {
            rms_mps2: as_it_arrives.rms_mps2(),
            rms_without_latency_mps2: without_latency.rms_mps2(),
        }
    }
}
