//! The rates of the UARTs, and of what is at their other ends.

use wimu_link::message::{Payload, Refusal};
use wimu_link::{Answer, Command, LinkRole};
use wimu_tests::who_are_you;

use super::run::{CABLE, Run, WIRELESS, happens, rate, request, run, send};

/// Ids of the requests that were accepted over the cable.
fn accepted(run: &Run) -> Vec<u32> {
    let replies = run.link(LinkRole::Cable).replies().iter();
    replies
        .filter(|reply| matches!(reply.answer, Answer::Accepted(_)))
        .map(|reply| reply.id)
        .collect()
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn the_rate_of_the_wireless_line_holds_from_the_next_start_on() {
    let run = run(
        5.0,
        &[
            send(1_000, CABLE, &request(1, Command::SetLineRate { baud: 300 })),
            send(1_200, CABLE, &request(2, Command::SetLineRate { baud: 38_400 })),
            happens(2_500, "power"),
            rate(2_500, WIRELESS, 38_400),
            send(4_000, WIRELESS, &request(1, Command::GetStatus)),
        ],
    );
    let [refused, accepted] = run.link(LinkRole::Cable).replies() else { panic!("two answers") };
    assert_eq!(refused.answer, Answer::Refused(Refusal::UnsupportedLineRate { nearest: 1200 }));
    assert_eq!(accepted.answer, Answer::Accepted(Payload::None));
    assert_eq!(run.boots(LinkRole::Wireless).len(), 2);
    assert_eq!(run.link(LinkRole::Wireless).replies().len(), 1);
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_host_at_another_rate_on_the_cable_is_counted_as_damage_and_nothing_else() {
    let mut script = vec![rate(800, CABLE, 57_600), rate(4_000, CABLE, 115_200)];
    script.extend((0..8).map(|k| send(1_000 + k * 300, CABLE, &who_are_you())));
    script.push(send(4_500, CABLE, &[0]));
    script.push(send(4_600, CABLE, &request(1, Command::GetStatus)));
    let run = run(6.0, &script);
    assert_eq!(accepted(&run), [1]);
    let status = run.boots(LinkRole::Cable)[0].status.expect("it was asked");
    let cable = status.cable.expect("it has one");
    assert!(cable.frames_damaged > 0, "{cable:?}");
    assert_eq!((status.sensor.missed, status.sensor.overruns), (0, 0));
    run.link(LinkRole::Wireless).assert_perfect();
}
