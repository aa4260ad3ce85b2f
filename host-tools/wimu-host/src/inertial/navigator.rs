//! A unit that is navigated step by step, with what carries it and what aids it. Every path is a loop over it: recorded and
//! live, with inertial samples, with wheels, and from ranges alone.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::{Matrix1, Matrix3, Vector3};
use wimu_nav::navigator::{self, Sample, SampleFault};
use wimu_nav::process::{ConstantVelocity, Odometry, OdometryBlocks, OdometryErrors, RandomWalk};
use wimu_nav::state::{self, Block, HEADING, Role};

use super::aids::position::POSITION;
use super::aids::range::RANGE;
use super::aids::{Aid, Kind, Place, State, Update};
use super::path::StateFound;
use super::segments::Segments;
use super::smooth::Tape;
use super::uses::{AidUse, Suspects};
use super::{Move, PathPoint, Residual, vehicle};
use crate::digits::significant;
use crate::localization::{AnchorStates, Increment};
use crate::plural::counted;
use crate::{Code, Problem};

/// A start in motion ends with the first rest of this length, s.
pub(super) const FIRST_REST_S: f64 = 0.5;
/// Part of the readings of the magnetic field above which rejected ones are reported: indoors iron explains some.
const MAGNET: f64 = 0.2;
/// Fixes of the position in succession that fail their test until one is taken for true: the path is wrong.
const CONTRADICTIONS: usize = 5;
/// A range whose line of sight is less probable is counted as not used.
const LINE_OF_SIGHT: f64 = 0.5;
/// Standard deviation of each heading that is tried, rad.
const HEADING_SD: f64 = 0.3;

/// Height of the unit.
const UP: Block<1> = state::POSITION.part::<1, 2>();

/// What carries a unit over a step.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Carrier {
    /// Specific force, and angular rate where there is a gyroscope.
    Sample(Sample),
    /// Nothing that was measured: a gap, or the accelerometer clips.
    Unmeasured,
    /// Wheels in the plane: the increment of which the step is a part.
    Wheels(Option<Increment>),
    /// White acceleration of a spectral density, m²/s³.
    Free(Vector3<f64>),
}

/// A step, with what is known of the motion at its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// Its end, s, and its length, s.
    pub time_s: f64,
    pub step_s: f64,
    pub carrier: Carrier,
    pub resting: bool,
    /// Standard deviation of the velocity of a foot in a stance, m/s.
    pub stance_mps: Option<f64>,
}

/// Points of a path, and what smooths them.
#[derive(Clone, Debug)]
struct Recorded {
    points: Vec<PathPoint>,
    tape: Tape,
}

/// States that a kind of aid has added.
#[derive(Clone, Debug)]
struct Added {
    kind: &'static Kind,
    blocks: Vec<Block<1>>,
    /// When they were predicted last, s.
    last_s: f64,
}

/// A unit.
#[derive(Clone, Debug)]
pub(crate) struct Navigator {
    pub core: navigator::Navigator,
    /// Measurements that are later than the last step.
    pending: VecDeque<Aid>,
    added: Vec<Added>,
    /// The anchors in the state, as soon as the path is in their frame.
    pub anchors: Option<AnchorStates>,
    wheels: Option<(OdometryBlocks, OdometryErrors)>,
    pub(super) segments: Segments,
    recorded: Option<Recorded>,
    now_s: f64,
    /// Whether its positions are in a frame that was given: that of fixes, or of a pose at the start.
    pub framed: bool,
    /// Number of the step at which position is zero: the last of the first rest.
    pub origin: Option<usize>,
    in_first_rest: bool,
    rest_s: f64,
    steps: usize,
    /// Of all aids.
    pub log_likelihood: f64,
    pub uses: BTreeMap<&'static str, AidUse>,
    pub residuals: Vec<Residual>,
    /// Aids outside of the time of the steps.
    outside: usize,
    in_succession: usize,
    /// When the path jumped to what aids show, s.
    pub jumps_s: Vec<f64>,
    /// Time of the last fix that was used, or of the start, and times before jumps in which the path was wrong, s.
    fixed_s: f64,
    wrong_s: Vec<[f64; 2]>,
    last_position_s: Option<f64>,
    suspects: Suspects,
    no_time: usize,
    not_finite: usize,
    /// Where the smoother is not used across.
    pub contradictions: usize,
}

impl Navigator {
    /// At the first step, which ends at `time_s`.
    pub fn new(core: navigator::Navigator, time_s: f64, at_rest: bool, framed: bool) -> Self {
        Self {
            core,
            pending: VecDeque::new(),
            added: Vec::new(),
            anchors: None,
            wheels: None,
            segments: Segments::from(time_s),
            recorded: None,
            now_s: time_s.next_down(),
            framed,
            origin: at_rest.then_some(0),
            in_first_rest: at_rest,
            rest_s: 0.0,
            steps: 0,
            log_likelihood: 0.0,
            uses: BTreeMap::new(),
            residuals: Vec::new(),
            outside: 0,
            in_succession: 0,
            jumps_s: Vec::new(),
            fixed_s: time_s,
            wrong_s: Vec::new(),
            last_position_s: None,
            suspects: Suspects::default(),
            no_time: 0,
            not_finite: 0,
            contradictions: 0,
        }
    }

    /// The same on wheels.
    pub fn on_wheels(mut self, errors: OdometryErrors) -> Self {
        let blocks = self.core.claim(|layout| OdometryBlocks::claim(layout, &errors));
        self.wheels = Some((blocks, errors));
        self
    }

    /// Keeps the points, and with `smooth` goes back over them at the end; `spans` are steps between which the covariance of
    /// the displacement is wanted. Before the first step.
    pub fn record(&mut self, smooth: bool, spans: Vec<(usize, usize)>) {
        let tape = Tape::new(smooth, spans, &mut self.core);
        self.recorded = Some(Recorded { points: Vec::new(), tape });
    }

    /// Moves to a place in the frame of fixes, at a heading, rad; with a velocity, m/s, where it is known.
    pub fn place(
        &mut self,
        Place { position_m, sd_m }: Place,
        velocity: Option<(Vector3<f64>, f64)>,
        heading: f64,
    ) {
        let solution = self.core.solution();
        let variance = Matrix3::from(solution.velocity_covariance).diagonal().max();
        let (velocity, velocity_sd) =
            velocity.unwrap_or((solution.velocity_mps.into(), variance.sqrt()));
        self.core.set_heading(heading);
        self.core.set_pose(position_m, velocity, heading, [sd_m.max(), velocity_sd, HEADING_SD]);
        let variance = Matrix3::from_diagonal(&sd_m.component_mul(&sd_m));
        self.core.change(|filter| filter.set_covariance(state::POSITION, &variance));
        self.framed = true;
    }

    /// Turns to the heading, rad, of fixes that have no horizontal position, and moves to their height, m, with its standard
    /// deviation.
    pub fn frame(&mut self, height: Option<[f64; 2]>, heading: f64) {
        self.core.set_heading(heading);
        if let Some([height_m, _]) = height {
            self.core.set_position(Vector3::z() * height_m);
        }
        self.core.change(|filter| {
            filter.set_covariance(HEADING, &Matrix1::new(HEADING_SD * HEADING_SD));
            if let Some([_, sd_m]) = height {
                filter.set_covariance(UP, &Matrix1::new(sd_m * sd_m));
            }
        });
    }

    /// Whether position is measured from a place that is known.
    pub fn has_origin(&self) -> bool {
        self.framed || self.origin.is_some()
    }

    /// A measurement, which is used with the first step that is not before it. One before the last step is left out.
    pub fn aid(&mut self, aid: &Aid) {
        if aid.time_s <= self.now_s {
            self.outside += 1;
            return;
        }
        if !aid.kind.states.is_empty() && !self.added.iter().any(|added| added.kind == aid.kind) {
            let claim =
                |state: &State| self.core.claim(|layout| layout.claim(Role::Estimated, [state.sd]));
            let blocks = aid.kind.states.iter().map(claim).collect();
            self.added.push(Added { kind: aid.kind, blocks, last_s: aid.time_s });
        }
        let at = self.pending.partition_point(|other| other.time_s <= aid.time_s);
        self.pending.insert(at, *aid);
    }

    /// Drops the measurements that were not used yet.
    pub fn without_aids(&mut self) {
        self.pending.clear();
    }

    /// The next step, and the measurements up to its end.
    pub fn step(&mut self, step: &Step) -> PathPoint {
        let recoveries = self.core.recoveries();
        self.carry(step);
        if let Some(deviation_mps) = step.stance_mps {
            self.core.stance(deviation_mps);
        }
        self.rest_s = if step.resting { self.rest_s + step.step_s } else { 0.0 };
        self.now_s = step.time_s;
        while let Some(aid) = self.pending.front().filter(|aid| aid.time_s <= step.time_s).copied()
        {
            self.pending.pop_front();
            self.take(&aid);
        }
        let found = self.core.take_consistency();
        if self.core.recoveries() > recoveries {
            self.segments.recover(step.time_s, &found);
        } else {
            let rests = step.resting.then(|| !self.core.doubts_rest());
            self.segments.see(step.time_s, &found, rests);
        }
        let rests = self.rest_s >= FIRST_REST_S && !self.core.doubts_rest();
        let lies = rests || step.stance_mps.is_some();
        if !self.has_origin() && lies {
            self.core.set_origin();
            (self.origin, self.in_first_rest) = (Some(self.steps), true);
        }
        self.in_first_rest &= step.resting;
        if self.in_first_rest {
            self.origin = Some(self.steps);
        }
        self.steps += 1;
        let point = self.now(step);
        if let Some(Recorded { points, tape }) = &mut self.recorded {
            points.push(point);
            tape.mark(&mut self.core, points);
        }
        point
    }

    fn carry(&mut self, step: &Step) {
        let step_s = step.step_s;
        match step.carrier {
            Carrier::Sample(sample) => match self.core.push(&sample, step.resting) {
                Ok(()) => {}
                Err(SampleFault::NoTime) => self.no_time += 1,
                Err(_) => self.not_finite += 1,
            },
            Carrier::Unmeasured => self.core.interrupt(step_s),
            Carrier::Free(density) => {
                self.core.travel(&ConstantVelocity { density, step_s }, step_s)
            }
            Carrier::Wheels(increment) => {
                // The first step has no length.
                let Some((blocks, errors)) = self.wheels.filter(|_| step_s > 0.0) else {
                    return;
                };
                let odometry = Odometry {
                    blocks: &blocks,
                    errors: &errors,
                    distance_m: increment.map_or(0.0, |i| i.distance_m),
                    rotation_rad: increment.map_or(0.0, |i| i.rotation_rad),
                    interval_s: increment.map_or(step_s, |i| i.interval_s),
                    step_s,
                };
                self.core.travel(&odometry, step_s);
            }
        }
    }

    /// Updates with a measurement.
    fn take(&mut self, aid: &Aid) {
        let added = self.added.iter_mut().find(|added| added.kind == aid.kind);
        let blocks = added.map_or_else(Vec::new, |added| {
            let step_s = aid.time_s - std::mem::replace(&mut added.last_s, aid.time_s);
            for (block, state) in added.blocks.iter().zip(aid.kind.states) {
                self.core.predict(&RandomWalk { block: *block, density: state.walk, step_s });
            }
            added.blocks.clone()
        });
        let is_position = *aid.kind == POSITION;
        let solution = self.core.solution();
        let off = Vector3::from(aid.value) - Vector3::from(solution.position_m);
        let off =
            off.zip_map(&Vector3::from(aid.sd), |off, sd| if sd.is_finite() { off } else { 0.0 });
        if is_position && self.in_succession >= CONTRADICTIONS {
            self.core.loosen(off.norm());
            self.jumps_s.push(aid.time_s);
            self.wrong_s.push([self.fixed_s, aid.time_s]);
        }
        let mut to = Update {
            navigator: &mut self.core,
            age_s: self.now_s - aid.time_s,
            states: &blocks,
            with_position: self.last_position_s == Some(aid.time_s),
            time_sd_s: aid.time_sd_s,
            anchors: self.anchors.as_mut(),
        };
        let found = (aid.kind.update)(aid, &mut to);
        let uses = self.uses.entry(aid.kind.name).or_insert_with(|| AidUse::of(aid.kind));
        let Some(found) = found else { return };
        let accepted = found.weight >= LINE_OF_SIGHT;
        uses.count(aid, accepted);
        self.log_likelihood += found.log_likelihood;
        if is_position {
            self.last_position_s = Some(aid.time_s);
            self.segments.see_fix(&found.innovation, aid.sd);
            self.in_succession = if accepted { 0 } else { self.in_succession + 1 };
            if accepted {
                self.fixed_s = aid.time_s;
            }
        }
        let is_range = *aid.kind == RANGE;
        if is_range || (is_position && accepted) {
            self.segments.locate();
        }
        if is_range {
            self.suspects.see(aid.source, aid.time_s, accepted);
        }
        if found.has_jumped {
            self.jumps_s.push(aid.time_s);
        }
        self.residuals.push(Residual {
            time_s: aid.time_s,
            aid: aid.kind.name,
            source: aid.source,
            value: found.innovation.value,
            statistic: found.innovation.statistic,
            dof: found.innovation.dof,
            weight: found.weight,
            accepted,
        });
    }

    /// Where the unit is at the end of a step.
    fn now(&self, step: &Step) -> PathPoint {
        let at_rest = step.resting && self.core.is_at_rest();
        let mut point = PathPoint {
            rate_rad_s: self.core.angular_rate().into(),
            resting: at_rest || step.stance_mps.is_some(),
            ..PathPoint::of(step.time_s, self.core.filter())
        };
        vehicle::by_clock_of_fixes(&mut point, &self.core);
        point
    }

    /// Ends the path: smooths its points and moves, and applies the variance factors.
    pub fn finish(&mut self, moves: &mut [Move]) -> (Vec<PathPoint>, Vec<Problem>) {
        self.outside += self.pending.len();
        self.pending.clear();
        let Some(Recorded { mut points, mut tape }) = self.recorded.take() else {
            return (Vec::new(), Vec::new());
        };
        tape.finish(&mut self.core, &mut points);
        self.contradictions = tape.contradictions;
        self.wrong_s.extend(self.denied_s().map(|from_s| [from_s, f64::INFINITY]));
        let is_wrong =
            |time_s| self.wrong_s.iter().any(|[from, to]| *from < time_s && time_s < *to);
        for point in &mut points {
            point.valid &= !is_wrong(point.time_s);
        }
        super::moves::smoothed_moves(moves, &points, &tape);
        let findings = self.segments.clone().finish(&mut points, moves);
        (points, findings)
    }

    /// When most aids of a kind began to contradict a path that no position shows, s: none knows which of them is right.
    fn denied_s(&self) -> Option<f64> {
        if self.last_position_s.is_some() || self.anchors.is_some() {
            return None;
        }
        let times = self.uses.values().filter_map(AidUse::denied_s);
        times.reduce(f64::min)
    }

    /// Whether aids contradicted the path, which jumped to them, or later samples what was before.
    pub fn is_contradicted(&self) -> bool {
        self.contradictions > 0 || !self.jumps_s.is_empty()
    }

    /// Estimated scale error of the wheels, with its standard deviation.
    pub fn wheel_scale(&self) -> Option<[f64; 2]> {
        self.wheels.map(|(blocks, _)| self.estimate(blocks.scale))
    }

    /// Value and standard deviation of a state.
    pub fn estimate(&self, block: Block<1>) -> [f64; 2] {
        let filter = self.core.filter();
        [filter.state.get(block).x, filter.covariance(block).x.max(0.0).sqrt()]
    }

    /// The states that aids have added.
    pub fn states(&self) -> Vec<StateFound> {
        let of = |added: &Added| {
            let pairs = added.kind.states.iter().zip(added.blocks.clone());
            let found = pairs.map(|(state, block)| {
                let [value, sigma] = self.estimate(block);
                let name = format!("{} {}", added.kind.name, state.name);
                StateFound { name, unit: state.unit, value, sigma }
            });
            found.collect::<Vec<_>>()
        };
        self.added.iter().flat_map(of).collect()
    }

    /// Whether fixes of the position were rejected.
    pub fn rejects_fixes(&self) -> bool {
        self.uses.get(POSITION.name).is_some_and(|uses| uses.rejected > 0)
    }

    /// The lever arm of fixes that was estimated.
    fn antenna(&self) -> Option<Problem> {
        let arm = self.added.iter().find(|added| *added.kind == POSITION)?;
        let [x, y, z] = <[_; 3]>::try_from(arm.blocks.clone()).ok()?.map(|b| self.estimate(b));
        let arm = [x, y, z].map(|[value, _]| format!("{value:.2}"));
        let sd_m = [x, y, z].into_iter().fold(0.0, |most: f64, [_, sd]| most.max(sd));
        let text = format!(
            "the fixes are of a point {} m from the unit, body axes, ± {} m: estimated, since they fit better so",
            arm.join(" "),
            significant(sd_m, 2)
        );
        let remedy = format!("measure it, and give it: --setup lever_arm_m=[{}]", arm.join(","));
        Some(Code::Navigation.warning(text).remedy(remedy))
    }

    /// What was noticed: samples and aids that were not used, recoveries and restarts of the filter.
    pub fn findings(&self) -> Vec<Problem> {
        let left_out = [
            (self.no_time, "whose time goes back: not used"),
            (self.not_finite, "that is not finite: not used"),
        ];
        let mut found = counted_findings(Code::SamplesLeftOut, "sample", &left_out);
        found.extend(self.antenna());
        for used in self.uses.values() {
            found.extend(used.finding());
        }
        found.extend(self.suspected());
        found.extend(self.jumps());
        found.extend(self.magnet());
        found.extend(vehicle::findings(&self.core));
        let diverged =
            "the filter diverged and began again. Check axes, signs and units of the sensors";
        let times = [
            (self.core.divergences() as usize, diverged),
            (
                self.contradictions,
                "the path is inconsistent with later samples: points before are not smoothed with data after",
            ),
        ];
        found.extend(counted_findings(Code::Navigation, "time", &times));
        if self.outside > 0 {
            let text =
                format!("{} outside the time of the recording", counted(self.outside, "fix"));
            let remedy = "check the unit of their times, and the clock";
            let most = self.outside > self.residuals.len();
            let problem = if most { Code::Clock.warning(text) } else { Code::Clock.note(text) };
            found.push(problem.remedy(remedy));
        }
        found
    }

    /// Anchors most of whose ranges contradict the path.
    pub fn suspected(&self) -> Option<Problem> {
        self.suspects.finding(self.anchors.as_ref()?)
    }

    /// Jumps to what aids show.
    fn jumps(&self) -> Option<Problem> {
        let (first, last) = self.jumps_s.first().zip(self.jumps_s.last())?;
        let times = counted(self.jumps_s.len(), "time");
        let text = match self.anchors {
            Some(_) => format!(
                "several ranges contradicted the path, {times}: it jumps to the position that they show"
            ),
            None => format!(
                "{CONTRADICTIONS} fixes in succession contradicted the path, {times}: it is not valid there, and jumps to the next one"
            ),
        };
        Some(Code::Navigation.warning(text).between(*first, *last))
    }

    /// A magnetic field that is not that of the Earth for part of the time.
    fn magnet(&self) -> Option<Problem> {
        let [used, rejected] = self.core.fields().map(f64::from);
        let part = rejected / (used + rejected).max(1.0);
        let text = format!(
            "the magnetic field contradicted the motion in {:.0} % of its readings, not used: magnet or iron near the unit?",
            100.0 * part
        );
        (part > MAGNET).then(|| Code::Navigation.warning(text))
    }
}

/// A warning for each count above zero: the number of something, and what happened to it.
pub(super) fn counted_findings(code: Code, one: &str, counts: &[(usize, &str)]) -> Vec<Problem> {
    let some = counts.iter().filter(|(count, _)| *count > 0);
    some.map(|(count, what)| code.warning(format!("{} {what}", counted(*count, one)))).collect()
}
