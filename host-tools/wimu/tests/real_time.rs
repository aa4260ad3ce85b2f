//! The device's clock by the wireless link alone in real time, over TCP. The other figures of the clock
//! are of virtual time.

use crate::kit;

use kit::{Simulator, folder, wimu};

/// By how much the board's clock is fast, ppm.
const FAST_PPM: f64 = 35.0;

#[test]
#[ignore = "takes eleven minutes, and a machine that does nothing else"]
fn figures_of_the_wireless_link_alone_in_real_time() {
    const SESSIONS: u32 = 10;
    let rate = (1.0 / (1.0 + FAST_PPM * 1e-6) - 1.0) * 1e6;
    let folder = folder();
    let (mut squares, mut within, mut held) = (0.0, 0, 0);
    for seed in 1..=SESSIONS {
        let board = Simulator::start(&[
            "--faults",
            &format!("noisy,clock={FAST_PPM}ppm"),
            "--motion",
            "hand",
            "--seed",
            &seed.to_string(),
        ]);
        let path = folder.path().join(format!("{seed}.mcap"));
        let file = path.to_str().unwrap();
        let recorded = wimu(&["record", &board.wireless, "-o", file, "--for", "65"]).succeeds();
        let clock = &recorded["links"][0]["clock"];
        let error = clock["rate_ppm"].as_f64().unwrap() - rate;
        let sd = clock["rate_sd_ppm"].as_f64().unwrap();
        println!("seed {seed}: rate wrong by {error:+.2} ± {:.2} ppm", 2.0 * sd);
        squares += error * error;
        within += u32::from(error.abs() <= 2.0);
        held += u32::from(error.abs() <= 1.96 * sd);
    }
    println!(
        "of {SESSIONS} sessions: {:.2} ppm rms, within 2 ppm {within}, intervals hold {held}",
        (squares / f64::from(SESSIONS)).sqrt()
    );
}
