//! Counts instructions per sample and prints them over semihosting, one line per function:
//! `name mean maximum`.

#![no_std]
#![no_main]

mod counter;
mod inertial;
mod signals;

use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m::asm::wfi;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use wimu_integrator::Segment;
use wimu_link::{Deframer, Kind, MAX_FRAME, batch, frame};
use wimu_model::{
    Corrector, Counts, DeviceTimeUs, ErrorModel, ErrorTerms, ParameterSet, PeriodNs, Sensitivity,
};

use counter::Counter;

/// Samples measured per function.
const SAMPLES: usize = 256;
/// Samples per batch.
const BATCH: usize = 16;
/// Sample period: 10 ms.
const PERIOD: PeriodNs = PeriodNs(10_000_000);
/// Gravity, 2⁻¹⁶ m/s², body axes.
const GRAVITY: [i32; 3] = [1_234, -567, 642_689];

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

/// With a length unknown to the compiler, as in a node.
#[inline(never)]
fn pack_batch(first: u32, samples: &[Counts], frame: &mut [u8]) -> usize {
    batch::encode(first, DeviceTimeUs(0), black_box(samples), frame).unwrap_or(0)
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
    let rest = signals::rest::<SAMPLES>();
    let motion = signals::motion::<SAMPLES>();
    let gravity = black_box(GRAVITY);

    let mut fused = Fused { corrector, segment: Segment::default(), gravity };
    let (mut sum, mut most) = (0, 0);
    for &counts in &motion {
        let cost = counter.count(|| correct_and_integrate(&mut fused, counts));
        sum += cost;
        most = most.max(cost);
    }
    black_box(&fused.segment);
    report("correction+integration", sum, SAMPLES as u32, most);
    pack(counter, "packing-rest", &rest);
    pack(counter, "packing-motion", &motion);
    Ok(())
}

/// Packing without framing: packing with framing, less framing alone.
fn pack(counter: &Counter, name: &str, samples: &[Counts]) {
    let mut frame = [0; MAX_FRAME];
    let mut deframer = Deframer::new();
    let (mut sum, mut most) = (0, 0);
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
        sum += both - framing;
        most = most.max((both - framing) / BATCH as u32);
    }
    report(name, sum, samples.len() as u32, most);
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

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("error: {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        wfi();
    }
}
