//! Views drawn into a buffer.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::prelude::Frame;

use wimu_host::guided::{GuidedView, Hold, Uncertainty, unit};
use wimu_host::monitor::LinkHealth;

use super::monitor::{Curve, MonitorView};
use crate::command::monitor::Line;

use super::{ascii, board, calibrate, monitor, paint, widgets};

/// The smallest screen, a large one, and one that is too small.
const USUAL: (u16, u16) = (80, 24);
const LARGE: (u16, u16) = (200, 60);
const TINY: (u16, u16) = (20, 5);

fn drawn((columns, rows): (u16, u16), ascii: bool, view: impl FnOnce(&mut Frame)) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("memory");
    terminal.draw(|frame| paint(frame, ascii, view)).expect("memory");
    terminal.backend().buffer().clone()
}

fn text(buffer: &Buffer) -> String {
    let rows = buffer.content.chunks(buffer.area.width.into());
    let row = |cells: &[ratatui::buffer::Cell]| cells.iter().map(|cell| cell.symbol()).collect();
    rows.map(row).collect::<Vec<String>>().join("\n")
}

/// Everything that a board can send, at its longest.
fn readings() -> MonitorView {
    let mut curve = Curve::default();
    for k in 0..300 {
        curve.add(f64::from(k).sin());
        curve.step(0);
    }
    let link = |name: &str| LinkHealth {
        name: name.to_owned(),
        lost: None,
        unverified: None,
        rate_hz: 1000.0,
        loss: 0.0123,
        latency_ms: Some([12.3, 1234.5]),
        kilobytes_s: 11.25,
        frames_damaged: 12_345,
    };
    let line = Line {
        sequence: 1,
        time_s: 12_345.6,
        raw_lsb: None,
        raw_angular_rate_lsb: None,
        specific_force_m_s2: [-19.123, 19.123, -9.807],
        angular_rate_rad_s: Some([-34.123, 34.123, -10.001]),
        corrected: true,
        parameter_id: Some("0123abcd".to_owned()),
        magnetic_field_ut: Some([-120.5, 20.5, 43.0]),
        magnetic_field_calibrated: Some(true),
        heading_deg: Some(359.0),
        heading_sd_deg: Some(12.0),
        temperature_c: Some(25.4),
        phase: Some("moving".to_owned()),
        velocity_m_s: Some([-1.5, 1.5, 0.25]),
        position_m: Some([-123.456, 123.456, -12.345]),
        since_rest_s: Some(1.25),
        valid: Some(true),
        quaternion: Some([0.5, -0.5, -0.5, 0.5]),
    };
    MonitorView {
        device: "pico-adxl345, LSM303AGR, 0123456789abcdef".to_owned(),
        line: Some(line),
        force_sd_mps2: Some(0.0157),
        force_curves: [0; 4].map(|_| curve.clone()),
        rate_curves: [0; 3].map(|_| curve.clone()),
        links: vec![link("wireless"), link("cable")],
        message: "12.34 s  mark 1".to_owned(),
        ..MonitorView::default()
    }
}

#[test]
fn missing_samples_are_a_gap_of_a_curve() {
    let mut view = readings();
    for curve in view.curves() {
        (0..600).for_each(|_| {
            curve.add(100.0);
            curve.step(0);
        });
        curve.add(100.0);
        curve.step(4);
        curve.add(100.0);
        curve.step(0);
    }
    let shown = text(&drawn((100, 40), false, |frame| monitor::draw(&view, frame)));
    let row = shown.lines().find(|line| line.contains("|f|")).unwrap();
    let is_bar = |c: char| ('▁'..='█').contains(&c);
    let bars: Vec<&str> = row.split(|c: char| !is_bar(c)).filter(|part| !part.is_empty()).collect();
    assert_eq!(bars.len(), 2, "{row}");
    assert_eq!(bars[1].chars().count(), 1, "{row}");
}

/// Changes the line of a view.
fn with(view: &MonitorView, change: impl FnOnce(&mut Line)) -> MonitorView {
    let mut view = view.clone();
    change(view.line.as_mut().expect("a line"));
    view
}

fn poses() -> GuidedView {
    let after = |bias: f64, no_fit: Option<&str>| Uncertainty {
        bias_mps2: [bias, 0.5 * bias, bias],
        scale: [0.03, 0.02, 0.0123],
        no_fit: no_fit.map(str::to_owned),
    };
    GuidedView {
        device: "microbit-v2 with LSM303AGR, cable link".to_owned(),
        sides: ["logo up", "logo down", "button A up", "button A down", "display up", "display down"],
        wanted: 12,
        poses: vec![[0.0, 0.0, 1.0], [0.6, 0.8, 0.0], [0.0, 0.0, -1.0]],
        up: Some([0.0, 0.0, 1.0]),
        next: Some([1.0, 0.0, 0.0]),
        instruction: "start with display down, then tilt it 45° towards button A up, then 35° towards logo up".to_owned(),
        hold: Hold::Holding(0.6, 1.5),
        uncertainty: vec![after(0.3, Some("2 static poses")), after(0.01, None)],
        message: "pose 3 captured: display down".to_owned(),
        resumable: true,
        ..GuidedView::default()
    }
}

#[test]
fn every_reading_has_its_place_on_the_smallest_screen() {
    for size in [USUAL, LARGE] {
        let shown = text(&drawn(size, false, |frame| monitor::draw(&readings(), frame)));
        for part in [
            "m/s² (corrected)",
            "rad/s",
            "|f| ",
            "-19.123",
            "+34.123",
            "moving for 1.2 s",
            "E -123.456 N +123.456 U -12.345 m",
            "± 0.012 m, below 1 m for 10.0 s",
            "E -1.500 N +1.500 U +0.250 m/s",
            "roll -90°  pitch +0°  yaw +90°",
            "-120.5 +20.5 +43.0 µT",
            "25.4 °C, heading 359° ± 12°",
            "0123abcd in use",
            "wireless",
            "cable",
            "1.23",
            "12.3 ms",
            "1234 ms",
            "12345",
            "mark 1",
            "quit",
            "calibrate",
            "12345.6 s",
        ] {
            assert!(shown.contains(part), "{part} at {size:?}:\n{shown}");
        }
    }
}

#[test]
fn what_is_wrong_is_said_where_its_value_would_be() {
    let show = |view: &MonitorView| text(&drawn(USUAL, false, |frame| monitor::draw(view, frame)));
    let mut view = with(&readings(), |line| line.parameter_id = Some("00000000".to_owned()));
    view.links[0].lost = Some("refused".to_owned());
    view.force_sd_mps2 = None;
    let shown = show(&view);
    for part in [
        "uncalibrated, press c",
        "LINK LOST: wireless (refused). Values are the last ones received. Check power,",
        "wimu reconnects by itself. q quits",
        "LINK LOST \n",
        "± unknown",
        "nominal",
    ] {
        assert!(shown.contains(part), "{part}:\n{shown}");
    }
    let mut view = with(&readings(), |line| line.valid = Some(false));
    view.paused = true;
    view.recording = Some("wimu-1.mcap".to_owned());
    let shown = show(&view);
    for part in [
        "invalid: it rotated",
        "PAUSED",
        "0123456789abcdef",
        "REC wimu-1.mcap",
        "stop recording",
        "continue",
    ] {
        assert!(shown.contains(part), "{part}:\n{shown}");
    }
    let view = with(&readings(), |line| line.phase = Some("searching".to_owned()));
    assert!(show(&view).contains("hold it still"));
    assert!(show(&MonitorView::default()).contains("quit"));
}

#[test]
fn a_guided_calibration_says_what_to_do_on_the_smallest_screen() {
    for size in [USUAL, LARGE] {
        let shown = text(&drawn(size, false, |frame| calibrate::draw(&poses(), 0, frame)));
        for part in [
            "pose 3 of 12",
            "next: hold it like this",
            "start with display down, then tilt it 45°",
            "X:logo",
            "90° from it: tilt it towards logo up",
            "still: 0.9 s more",
            "standard deviation of the fit",
            "± 1.0 X, 0.51 Y, 1.0 Z mg",
            "± 3.0 X, 2.0 Y, 1.2 Z %",
            "captured: display down",
            "resume the interrupted session",
            "undo",
            "skip",
            "finish now",
        ] {
            assert!(shown.contains(part), "{part} at {size:?}:\n{shown}");
        }
    }
    let mut view = poses();
    view.lost = Some("no answer".to_owned());
    view.uncertainty.truncate(1);
    let shown = text(&drawn(USUAL, false, |frame| calibrate::draw(&view, 1, frame)));
    assert!(shown.contains("LINK LOST: the board (no answer). Poses are kept."), "{shown}");
    assert!(shown.contains("no fit yet: 2 static poses"), "{shown}");
    assert!(shown.contains("not a result yet"), "{shown}");
    view.result = Some("usable\nX: bias".to_owned());
    view.usable = true;
    let shown = text(&drawn(USUAL, false, |frame| calibrate::draw(&view, 1, frame)));
    assert!(
        shown.contains("p pushes it") && !shown.contains("usable") && shown.contains("X: bias"),
        "{shown}"
    );
}

#[test]
fn a_long_message_wraps_and_a_value_is_within_its_limits() {
    let mut view = with(&readings(), |line| line.specific_force_m_s2[0] = 19.126);
    view.message = format!("not pushed: {}end", "words of a remedy ".repeat(8));
    let shown = text(&drawn(USUAL, false, |frame| monitor::draw(&view, frame)));
    assert!(shown.contains("remedy end"), "{shown}");
    assert!(shown.contains("quit"), "{shown}");
    let row = shown.lines().find(|row| row.contains("x   "));
    assert!(row.is_some_and(|row| row.contains("to +19.13")), "{shown}");
}

#[test]
fn a_terminal_that_is_too_small_says_how_large_it_must_be() {
    for size in [TINY, (79, 24), (80, 23)] {
        let shown = text(&drawn(size, false, |frame| monitor::draw(&readings(), frame)));
        assert!(shown.contains("too small"), "{shown}");
        assert!(shown.contains("80x24"), "{shown}");
    }
    for size in [(1, 1), (2, 1), (1, 3)] {
        drawn(size, true, |frame| calibrate::draw(&poses(), 0, frame));
    }
}

#[test]
fn a_plain_screen_is_ascii_and_keeps_every_word() {
    for size in [USUAL, LARGE] {
        let shown = text(&drawn(size, true, |frame| monitor::draw(&readings(), frame)));
        assert!(shown.is_ascii(), "{shown}");
        assert!(!shown.contains('?'), "{shown}");
        for part in ["m/s2", "359 +/-12", "-120.5 +20.5 +43.0 uT", "+/-0.012 m"] {
            assert!(shown.contains(part), "{part}:\n{shown}");
        }
        let shown = text(&drawn(size, true, |frame| calibrate::draw(&poses(), 0, frame)));
        assert!(shown.is_ascii() && !shown.contains('?'), "{shown}");
    }
}

#[test]
fn utf8_is_named_by_the_first_variable_that_is_set() {
    let locale = |all: &'static str, lang: &'static str| {
        ascii::is_utf8(move |name| match name {
            "LC_ALL" => Some(all.to_owned()),
            "LANG" => Some(lang.to_owned()),
            _ => None,
        })
    };
    assert!(locale("", "en_US.UTF-8"));
    assert!(locale("C.utf8", "C"));
    assert!(!locale("C", "en_US.UTF-8"));
    assert!(!locale("", "de_DE.ISO-8859-1"));
    assert_eq!(ascii::is_utf8(|_| None), cfg!(windows));
}

#[test]
fn the_side_to_raise_reduces_the_tilt() {
    let directions: Vec<[f64; 3]> = (wimu_calib::Orientation::ALL).iter().map(|o| o.up()).collect();
    for up in &directions {
        for wanted in directions.iter().filter(|wanted| *wanted != up) {
            let before = board::angle_deg(*up, *wanted);
            if before > 179.0 {
                continue;
            }
            let side = board::side_to_raise(*up, *wanted);
            let mut moved = *up;
            moved[side / 2] += if side.is_multiple_of(2) { 0.1 } else { -0.1 };
            let moved = unit(moved).expect("a direction");
            let after = board::angle_deg(moved, *wanted);
            assert!(after < before, "{up:?} to {wanted:?}: side {side}, {before} to {after}");
        }
    }
    assert!((board::angle_deg([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]) - 90.0).abs() < 1e-9);
}

#[test]
fn a_curve_spans_its_values_or_at_least_the_noise() {
    assert_eq!(widgets::bounds([1.0, 3.0].into_iter(), 0.1), [1.0, 3.0]);
    let [low, high] = widgets::bounds([1.0, 1.01].into_iter(), 0.1);
    assert!((high - low - 0.1).abs() < 1e-12 && low < 1.0 && high > 1.01);
    assert_eq!(widgets::bounds([].into_iter(), 0.2), [-0.1, 0.1]);
}
