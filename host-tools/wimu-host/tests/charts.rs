//! Charts and pages: few points with all extremes, any points, and names that act on nothing.

use wimu_host::Code;
use wimu_host::chart::{Band, Chart, Series, broken};
use wimu_host::document::Document;
use wimu_host::formats::Overview;
use wimu_host::recording::{Quantity, Sink, TrackInfo, Unit};

fn chart(points: Vec<(f64, f64)>, log: bool) -> Chart {
    Chart {
        title: "a < b".to_owned(),
        x: "t (s)".to_owned(),
        y: "p (m)".to_owned(),
        log,
        series: vec![if log { Series::dots("one", points) } else { Series::line("one", points) }],
        bands: vec![Band {
            series: 0,
            points: vec![(0.0, f64::NAN, 1.0), (0.0, 0.5, 1.0), (1.0, 0.5, 1.5)],
        }],
        marked: vec![(0.2, 0.4)],
        ..Chart::default()
    }
}

#[test]
fn any_points_can_be_drawn() {
    for points in [
        vec![],
        vec![(1.0, 2.0)],
        vec![(0.0, 1.0), (1.0, 1.0)],
        vec![(0.0, f64::NAN), (1.0, f64::INFINITY)],
        vec![(0.0, 1e-3), (1.0, 1e3)],
    ] {
        for log in [false, true] {
            let svg = chart(points.clone(), log).svg();
            assert!(svg.contains("</svg>") && svg.contains("t (s)"));
        }
    }
}

#[test]
fn a_line_is_broken_where_points_are_missing() {
    let line = |xs: &[f64]| xs.iter().map(|x| (*x, 1.0)).collect::<Vec<_>>();
    let found = broken(line(&[0.0, 1.0, 2.0, 7.0, 8.0]));
    assert_eq!(found.len(), 6);
    assert!(found[3].0 == 2.0 && found[3].1.is_nan());
    for whole in [&[][..], &[0.0], &[0.0, 5.0], &[0.0, 1.0, 3.0]] {
        assert_eq!(broken(line(whole)), line(whole));
    }
}

/// What is written of a page.
fn page(report: &Document) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.html");
    report.write(&path).unwrap();
    std::fs::read_to_string(path).unwrap()
}

/// The data in a page.
fn data(page: &str) -> serde_json::Value {
    let (_, data) = page.split_once("json\">").unwrap();
    let (data, _) = data.split_once("</script>").unwrap();
    serde_json::from_str(data).unwrap()
}

const EVIL: &str = "</script><img src=x onerror=alert(1)><!--\"&";

#[test]
fn names_cannot_break_the_page() {
    let mut report = Document::new(EVIL);
    report.result(EVIL).key(EVIL, EVIL).printed(EVIL).findings(&[Code::Clock.warning(EVIL)]).table(
        EVIL,
        &[EVIL],
        &[vec![EVIL.to_owned()]],
    );
    let chart = Chart {
        title: EVIL.to_owned(),
        x: EVIL.to_owned(),
        note: EVIL.to_owned(),
        series: vec![Series {
            labels: vec![EVIL.to_owned()],
            ..Series::dots(EVIL, vec![(0.0, f64::NAN)])
        }],
        ..Chart::default()
    };
    let page = page(report.chart(&chart));
    assert!(!page.contains("<img") && !page.contains("<!--"), "{page}");
    // The data and the script of the page, once each.
    assert_eq!(page.matches("</script>").count(), 2);
    let data = data(&page);
    assert_eq!(data["title"], EVIL);
    assert!(data["series"][0]["y"][0].is_null());
}

#[test]
fn a_page_keeps_every_extreme_and_every_break_of_many_points() {
    let mut points: Vec<(f64, f64)> =
        (0..100_000).map(|k| (f64::from(k), f64::from(k % 7))).collect();
    points[12_345].1 = 99.0;
    points[54_321].1 = -99.0;
    points[77_777].1 = f64::NAN;
    let chart = Chart { series: vec![Series::line("a", points)], ..Chart::default() };
    let page = page(Document::new("a").chart(&chart));
    let data = data(&page);
    let values = |axis: &str| data["series"][0][axis].as_array().unwrap().clone();
    let (x, y) = (values("x"), values("y"));
    assert!((2000..=16_000).contains(&x.len()), "{}", x.len());
    for k in [0, 12_345, 54_321, 99_999] {
        assert!(x.iter().any(|x| x.as_f64() == Some(f64::from(k))), "{k}");
    }
    assert_eq!(y.iter().filter(|y| y.is_null()).count(), 1);
}

#[test]
fn a_long_track_keeps_its_extremes_in_few_points() {
    let mut overview = Overview::default();
    let track = overview.track(TrackInfo::new("a", Quantity::SpecificForce, Unit::Si));
    for k in 0..200_000_i64 {
        let spike = if k == 123_457 { 99.0 } else { (k as f64).sin() };
        overview.row(track, k * 1_000_000, &[spike, 0.0, -1.0]);
    }
    let charts = overview.charts();
    let points = &charts[0].series[0].points;
    assert!(points.len() < 20_000 && points.is_sorted_by(|a, b| a.0 <= b.0), "{}", points.len());
    let at = points.iter().find(|point| point.1 == 99.0).unwrap().0;
    assert!((at - 123.457).abs() < 2.0, "{at}");
}
