//! The rates of the UARTs, and of what is at their other ends.

use wimu_link::message::Refusal;
use wimu_link::{Answer, Command, LinkRole};
use wimu_tests::who_are_you;

use super::run::{CABLE, Run, WIRELESS, happens, rate, request, run, send};

fn set_cable(id: u32, baud: u32) -> Vec<u8> {
    let link = LinkRole::Cable.number();
    request(id, Command::SetLineRate { link, baud })
}

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
fn both_ends_of_the_cable_change_their_rate_and_the_board_keeps_it_over_a_power_cut() {
    let run = run(
        6.0,
        &[
            send(1_000, CABLE, &set_cable(1, 460_800)),
            rate(1_500, CABLE, 460_800),
            send(1_600, CABLE, &who_are_you()),
            send(2_000, CABLE, &request(2, Command::GetStatus)),
            happens(3_000, "power"),
            send(4_000, CABLE, &who_are_you()),
            send(4_500, CABLE, &request(3, Command::GetStatus)),
        ],
    );
    assert_eq!(accepted(&run), [1, 2, 3]);
    let cable = run.link(LinkRole::Cable);
    assert_eq!(run.boots(LinkRole::Cable).len(), 2);
    // What is heard of the second start, all of it at the new rate, is whole.
    let boot = &run.boots(LinkRole::Cable)[1];
    assert!(boot.raw.len() > 200, "{}", boot.raw.len());
    // A frame ends with a zero. One that is damaged ends with a zero that was heard at another rate
    // than it was sent at, or is the first at the right rate after that: the host followed once, and
    // the board did once after its start.
    let damaged = cable.record().statistics.frames_damaged;
    let strange = run.report["strange_zeros"][usize::from(CABLE)].as_u64();
    let strange = strange.expect("a number");
    assert!(strange > 0, "the host was not late");
    assert!(damaged <= strange + 2, "{damaged} of {strange}");
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn a_board_whose_host_does_not_follow_is_back_at_the_old_rate_after_five_seconds() {
    let run = run(
        9.0,
        &[
            send(1_000, CABLE, &set_cable(1, 9600)),
            send(7_000, CABLE, &request(2, Command::GetStatus)),
            send(7_500, CABLE, &set_cable(3, 300)),
        ],
    );
    assert_eq!(accepted(&run), [1, 2]);
    let replies = run.link(LinkRole::Cable).replies();
    let refused = Refusal::UnsupportedLineRate { nearest: 1200 };
    assert_eq!(replies[2].answer, Answer::Refused(refused));
    run.link(LinkRole::Wireless).assert_perfect();
}

#[test]
#[ignore = "cargo xtask release --only pico"]
fn the_radio_adapters_rate_is_found_and_kept() {
    for baud in [9600, 38_400] {
        let mut script = vec![rate(0, WIRELESS, baud), happens(10_000, "power")];
        script.extend((0..22).map(|k| send(500 + k * 400, WIRELESS, &who_are_you())));
        script.push(send(10_600, WIRELESS, &who_are_you()));
        script.push(send(11_500, WIRELESS, &request(1, Command::GetStatus)));
        let run = run(13.0, &script);
        let boots = run.boots(LinkRole::Wireless);
        let [before, after] = boots else {
            panic!("{} starts", boots.len());
        };
        let found = before.hello.expect("it was found");
        assert!(found.uptime_us < 9_500_000, "{}", found.uptime_us);
        assert!(after.hello.is_some());
        assert_eq!(run.link(LinkRole::Wireless).replies().len(), 1, "{baud}");
        // The frame that the power cut, no more.
        let cable = run.link(LinkRole::Cable).record().statistics;
        assert!(cable.frames_damaged <= 1, "{cable:?}");
        assert_eq!(cable.raw.missing, 0);
    }
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
