//! Sends frames through a faulty link and compares every sample that is accepted with the one that
//! was sent: `cargo run --release -p wimu-tests --example noisy_link [FRAMES [FAULTS [SEED]]]`.

use std::error::Error;
use std::time::Instant;

use wimu_sim::faults::LinkFaults;
use wimu_testkit::figure;
use wimu_tests::campaign;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let frames: u64 = arguments.next().map_or(Ok(10_000_000), |n| n.parse())?;
    let spec = arguments.next().unwrap_or_else(|| "noisy".to_owned());
    let seed: u64 = arguments.next().map_or(Ok(1), |n| n.parse())?;
    let faults: LinkFaults = spec.parse()?;
    let start = Instant::now();
    // A tenth first: memory that grows with the length would show.
    campaign::run(frames / 10, &faults, !seed);
    let memory = peak_memory_kib();
    let outcome = campaign::run(frames, &faults, seed);
    let faults = outcome.faults;
    println!("{frames} frames through `{spec}`, seed {seed}");
    println!(
        "bytes      {} sent, {:.2} % lost, {} bits flipped ({:.1e})",
        faults.bytes_sent,
        100.0 * (faults.bytes_lost + faults.bytes_overflowed) as f64 / faults.bytes_sent as f64,
        faults.bits_flipped,
        faults.bits_flipped as f64 / (8 * faults.bytes_delivered) as f64,
    );
    println!(
        "frames     {} intact, {} damaged, {} without a zero before them, {} lost",
        faults.frames_intact, faults.frames_damaged, faults.frames_fused, faults.frames_lost,
    );
    println!(
        "samples    {} accepted of {} in frames that arrived whole ({} of them ended by the zero of a lost neighbour), {} lost, {} counted as missing or late",
        outcome.accepted,
        outcome.samples_whole,
        outcome.samples_rescued,
        outcome.lost,
        outcome.counted_lost(),
    );
    println!("wrong      {}", outcome.wrong);
    println!(
        "longest    {} undamaged frame(s) in a row not read after damage; {} restarts seen",
        outcome.longest_resynchronisation, outcome.restarts
    );
    let wrong = format!("{} of {}", outcome.wrong, outcome.accepted);
    figure("wrong samples accepted from a bad link", wrong, "none", outcome.wrong == 0);
    figure(
        "lost samples of a bad link that are counted as lost",
        format!("{} of {}", outcome.counted_lost(), outcome.lost),
        "all",
        outcome.counted_lost() == outcome.lost,
    );
    figure(
        "samples accepted of those that arrived whole",
        format!("{} of {}", outcome.accepted, outcome.samples_whole),
        "all",
        outcome.accepted == outcome.samples_whole,
    );
    figure(
        "undamaged frames not read after a damaged one",
        format!("at most {}", outcome.longest_resynchronisation),
        "at most 1",
        outcome.longest_resynchronisation <= 1,
    );
    if let (Some(before), Some(after)) = (memory, peak_memory_kib()) {
        let [before, after] = [before, after].map(|kib| kib as f64 / 1024.0);
        figure(
            "memory after a tenth of a bad link's frames, and in the end",
            format!("{before:.1} / {after:.1} MiB"),
            "1 MiB more at most",
            after < before + 1.0,
        );
    }
    println!("took       {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// The most memory that this process had, where the system tells.
fn peak_memory_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}
