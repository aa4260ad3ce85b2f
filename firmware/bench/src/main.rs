//! Counts instructions per sample and prints them over semihosting, one line per function:
//! `name mean maximum`.

#![no_std]
#![no_main]

#[cfg(target_abi = "eabihf")]
mod counter;
mod float;
mod inertial;
mod signals;

use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m::asm::wfi;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use wimu_integrator::{Config, Integrator, Segment};
use wimu_link::{Deframer, Kind, MAX_FRAME, batch, frame};
use wimu_model::{
    Corrector, Counts, DeviceTimeUs, ErrorModel, ErrorTerms, ParameterSet, PeriodNs, Sensitivity,
    SpecificForceQ16,
};

use counter::Counter;

/// Samples measured per function.
const SAMPLES: usize = 256;
/// Samples per batch.
const BATCH: usize = 16;
/// Sample period: 10 ms.
const PERIOD: PeriodNs = PeriodNs(10_000_000);
/// Positive full scale of the 12-bit LSM303AGR, LSB of the left-justified 16-bit counts.
const FULL_SCALE: i32 = 32752;
/// Gravity, 2⁻¹⁶ m/s², body axes.
const GRAVITY: [i32; 3] = [1_234, -567, 642_689];

// One function each, so that call and return are counted too.

#[inline(never)]
fn correct(corrector: &Corrector, counts: Counts) -> SpecificForceQ16 {
    corrector.correct(counts)
}

#[inline(never)]
fn integrate(segment: &mut Segment, force: SpecificForceQ16, gravity: &[i32; 3]) {
    segment.step(force, *gravity);
}

/// The state of correction and integration. The fixed layout makes the counts independent of the order in
/// which the compiler places fields.
#[repr(C)]
struct Fused {
    gravity: [i32; 3],
    segment: Segment,
    corrector: Corrector,
}

#[inline(never)]
fn correct_and_integrate(fused: &mut Fused, counts: Counts) {
    let force = fused.corrector.correct(counts);
    fused.segment.step(force, fused.gravity);
}

#[inline(never)]
fn integrator_step(integrator: &mut Integrator<()>, force: SpecificForceQ16) {
    integrator.step(force, false);
}

#[inline(never)]
fn saturated(counts: Counts) -> bool {
    counts.saturated(black_box(FULL_SCALE))
}

#[inline(never)]
fn correct_f32(corrector: &float::Corrector, counts: Counts, force: &mut [f32; 3]) {
    *force = corrector.correct(counts);
}

#[inline(never)]
fn integrate_f32(segment: &mut float::Segment, force: &[f32; 3], gravity: &[f32; 3], half: f32) {
    segment.step(*force, *gravity, half);
}

#[inline(never)]
fn correct_and_integrate_f32(
    corrector: &float::Corrector,
    segment: &mut float::Segment,
    counts: Counts,
    gravity: &[f32; 3],
    half: f32,
) {
    segment.step(corrector.correct(counts), *gravity, half);
}

/// With a length unknown to the compiler, as in a node.
#[inline(never)]
fn pack_batch(first: u32, samples: &[Counts], frame: &mut [u8]) -> usize {
    batch::encode(first, DeviceTimeUs(0), black_box(samples), frame).unwrap_or(0)
}

/// The processing of a sample in the sampler's task.
struct Path {
    corrector: Corrector,
    integrator: Integrator<()>,
    samples: [Counts; BATCH],
    count: usize,
    frame: [u8; MAX_FRAME],
}

impl Path {
    #[inline(never)]
    fn take(&mut self, counts: Counts) {
        let saturated = counts.saturated(FULL_SCALE);
        self.integrator.step(self.corrector.correct(counts), saturated);
        self.samples[self.count % BATCH] = counts;
        self.count += 1;
        if self.count.is_multiple_of(BATCH) {
            let first = self.count as u32;
            pack_batch(first, &self.samples, &mut self.frame);
        }
    }
}

#[entry]
fn main() -> ! {
    match measure() {
        Ok(()) => debug::exit(debug::EXIT_SUCCESS),
        Err(problem) => {
            hprintln!("error: {}", problem);
            debug::exit(debug::EXIT_FAILURE);
        }
    }
    loop {
        wfi();
    }
}

fn measure() -> Result<(), &'static str> {
    let peripherals = cortex_m::Peripherals::take().ok_or("peripherals are taken")?;
    let counter = Counter::new(peripherals.SYST)
        .ok_or("time does not follow instructions: run QEMU with -icount shift=10")?;
    // In separate functions: the smaller processor has 16 kB of RAM for both.
    inertial::measure(&counter)?;
    samples(&counter)
}

#[inline(never)]
fn samples(counter: &Counter) -> Result<(), &'static str> {
    let parameters = parameters().ok_or("the parameters are refused")?;
    let corrector = black_box(Corrector::compile(&parameters, None).map_err(|_| "no corrector")?);
    let integrator = Integrator::three_axes(Config::new(PERIOD).map_err(|_| "no period")?);

    let rest = signals::rest::<SAMPLES>();
    let motion = signals::motion::<SAMPLES>();
    let gravity = black_box(GRAVITY);

    let each = |name: &str, code: &mut dyn FnMut(Counts) -> u32| {
        let (mut sum, mut most) = (0, 0);
        for &counts in &motion {
            let cost = code(counts);
            sum += cost;
            most = most.max(cost);
        }
        report(name, sum, SAMPLES as u32, most);
    };

    each("correction", &mut |counts| {
        counter.count(|| {
            black_box(correct(&corrector, counts));
        })
    });
    let mut segment = Segment::default();
    each("integration", &mut |counts| {
        let force = corrector.correct(counts);
        counter.count(|| integrate(&mut segment, force, &gravity))
    });
    black_box(&segment);
    let mut fused = Fused { corrector, segment: Segment::default(), gravity };
    each("correction+integration", &mut |counts| {
        counter.count(|| correct_and_integrate(&mut fused, counts))
    });
    black_box(&fused.segment);
    each("saturation", &mut |counts| {
        counter.count(|| {
            black_box(saturated(counts));
        })
    });
    let mut integrator_moving = integrator.clone();
    each("integrator-step", &mut |counts| {
        let force = corrector.correct(counts);
        counter.count(|| integrator_step(&mut integrator_moving, force))
    });
    black_box(&integrator_moving);
    each("gap", &mut |counts| {
        integrator_moving.step(corrector.correct(counts), false);
        counter.count(|| integrator_moving.gap())
    });

    let float_corrector = black_box(float_corrector(&parameters));
    let gravity = black_box(GRAVITY.map(|g| g as f32 / 65536.0));
    let half = black_box(0.005);
    let mut force = [0.0; 3];
    each("correction-f32", &mut |counts| {
        counter.count(|| correct_f32(&float_corrector, counts, &mut force))
    });
    black_box(&force);
    let mut segment = float::Segment::default();
    each("integration-f32", &mut |counts| {
        let force = float_corrector.correct(counts);
        counter.count(|| integrate_f32(&mut segment, &force, &gravity, half))
    });
    black_box(&segment);
    each("correction+integration-f32", &mut |counts| {
        counter.count(|| {
            correct_and_integrate_f32(&float_corrector, &mut segment, counts, &gravity, half)
        })
    });
    black_box(&segment);

    pack(counter, ["packing-rest", "framing-rest", "batch-rest"], &rest);
    pack(counter, ["packing-motion", "framing-motion", "batch-motion"], &motion);

    for (name, samples) in [("path-rest", &rest), ("path-motion", &motion)] {
        let mut path = Path {
            corrector,
            integrator: integrator.clone(),
            samples: [Counts::default(); BATCH],
            count: 0,
            frame: [0; MAX_FRAME],
        };
        let (mut sum, mut most) = (0, 0);
        for &counts in samples {
            let cost = counter.count(|| path.take(counts));
            sum += cost;
            most = most.max(cost);
        }
        report(name, sum, SAMPLES as u32, most);
    }
    Ok(())
}

/// Packing with framing, and framing alone; the difference is packing alone.
fn pack(counter: &Counter, names: [&str; 3], samples: &[Counts]) {
    let mut frame = [0; MAX_FRAME];
    let mut deframer = Deframer::new();
    let mut sums = [0; 3];
    let mut most = [0; 3];
    for (number, chunk) in samples.chunks_exact(BATCH).enumerate() {
        let mut length = 0;
        let both = counter.count(|| {
            length = pack_batch(number as u32, chunk, &mut frame);
        });
        let Some(Ok(unpacked)) = frame[..length].iter().find_map(|&byte| {
            let frame = deframer.push(byte)?;
            Some(frame.map(|frame| {
                let mut body = [0; 128];
                body[..frame.body.len()].copy_from_slice(frame.body);
                (body, frame.body.len())
            }))
        }) else {
            continue;
        };
        let body = &unpacked.0[..unpacked.1];
        let framing = counter.count(|| {
            let _ = black_box(frame::encode(Kind::Batch, body, &mut frame));
        });
        for (i, cost) in [both - framing, framing, both].into_iter().enumerate() {
            sums[i] += cost;
            most[i] = most[i].max(cost / BATCH as u32);
        }
    }
    for (i, name) in names.into_iter().enumerate() {
        report(name, sums[i], samples.len() as u32, most[i]);
    }
}

fn report(name: &str, sum: u32, of: u32, most: u32) {
    hprintln!("{} {}.{} {}", name, sum / of, sum * 10 / of % 10, most);
}

fn parameters() -> Option<ParameterSet> {
    let model = ErrorModel::new(ErrorTerms {
        bias_mps2: [0.31, -0.42, 0.55],
        matrix: [[1.02, 0.01, -0.02], [0.015, 0.98, 0.01], [-0.01, 0.02, 1.01]],
        ..ErrorTerms::default()
    })
    .ok()?;
    Some(ParameterSet {
        model,
        ..ParameterSet::uncalibrated(4, Sensitivity::from_lsb_per_g(8192.0).ok()?)
    })
}

fn float_corrector(parameters: &ParameterSet) -> float::Corrector {
    let at = |counts| parameters.correct(Counts(counts), None).0.map(|f| f as f32);
    let offset = at([0; 3]);
    let mut matrix = [[0.0; 3]; 3];
    for column in 0..3 {
        let mut unit = [0; 3];
        unit[column] = 16384;
        let image = at(unit);
        for row in 0..3 {
            matrix[row][column] = (image[row] - offset[row]) / 16384.0;
        }
    }
    float::Corrector { matrix, offset }
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("error: {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        wfi();
    }
}
