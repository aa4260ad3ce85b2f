//! Texts that name a link.

use wimu_host::{Code, Input, LinkUrl};

fn serial(path: &str, baud: u32) -> LinkUrl {
    LinkUrl::Serial { path: path.to_owned(), baud }
}

fn tcp(host: &str, port: u16) -> LinkUrl {
    LinkUrl::Tcp { host: host.to_owned(), port }
}

#[test]
fn every_documented_form_parses_and_prints_back() {
    for (text, link) in [
        ("serial:///dev/ttyACM0?baud=9600", serial("/dev/ttyACM0", 9600)),
        ("serial:///dev/ttyACM0", serial("/dev/ttyACM0", 115_200)),
        ("serial://COM5", serial("COM5", 115_200)),
        ("serial:///COM5?baud=115200", serial("COM5", 115_200)),
        ("COM12", serial("COM12", 115_200)),
        ("/dev/rfcomm0", serial("/dev/rfcomm0", 115_200)),
        ("/dev/cu.usbmodem1", serial("/dev/cu.usbmodem1", 115_200)),
        ("tcp://127.0.0.1:7100", tcp("127.0.0.1", 7100)),
        ("tcp://localhost:1/", tcp("localhost", 1)),
        ("tcp://[::1]:7100", tcp("::1", 7100)),
        (
            "mqtts://me@host/hall/b-1",
            LinkUrl::Mqtt {
                broker: "mqtts://me@host:8883".parse().unwrap(),
                fleet: "hall".parse().unwrap(),
                board: "b-1".parse().unwrap(),
            },
        ),
        ("auto", LinkUrl::Auto),
    ] {
        let parsed: LinkUrl = text.parse().unwrap();
        assert_eq!(parsed, link, "{text}");
        assert_eq!(parsed.to_string().parse::<LinkUrl>().unwrap(), link);
    }
}

#[test]
fn what_is_no_link_says_what_is_wrong() {
    for (text, code, part) in [
        ("serial://", Code::BadLink, "port is missing"),
        ("serial:///dev/ttyS0?baud=fast", Code::BadLink, "`fast`"),
        ("serial:///dev/ttyS0?baud=0", Code::BadLink, "`0`"),
        ("serial:///dev/ttyS0?parity=even", Code::BadLink, "parity=even"),
        ("tcp://127.0.0.1", Code::BadLink, "port is missing"),
        ("tcp://::1:7100", Code::BadLink, "brackets"),
        ("tcp://:7100", Code::BadLink, "host is missing"),
        ("tcp://host:99999", Code::BadLink, "99999"),
        ("mqtt://host/hall", Code::BadLink, "missing"),
        ("mqtt://host/hall/#", Code::BadLink, "'#'"),
        ("mqtt://host/a/b/c", Code::BadLink, "'/'"),
        ("mqtt:///hall/b", Code::BadLink, "host is missing"),
        #[cfg(not(feature = "ble"))]
        ("ble://wimu", Code::LinkKindMissing, "Low Energy"),
        #[cfg(feature = "ble")]
        ("ble:///", Code::BadLink, "name of the unit"),
        ("http://host", Code::BadLink, "`http`"),
        ("COMX", Code::BadLink, "not a LINK"),
        ("", Code::BadLink, "not a LINK"),
        ("²²", Code::BadLink, "not a LINK"),
    ] {
        let error = text.parse::<LinkUrl>().unwrap_err();
        assert_eq!(error.code, code, "{text}");
        assert!(error.text.contains(part), "{text}: {error}");
        assert_eq!(error.exit_code(), 2);
    }
}

#[test]
fn an_input_that_is_neither_file_nor_link_is_told_both() {
    let error = Input::parse("no/such/file.csv").unwrap_err();
    assert_eq!(error.code, Code::FileUnreadable);
    assert!(error.remedy.contains("LINK"));
    assert_eq!(Input::parse("tcp://127.0.0.1:7100").unwrap(), Input::Link(tcp("127.0.0.1", 7100)));
    #[cfg(not(feature = "ble"))]
    {
        let error = Input::parse("ble://x").unwrap_err();
        assert_eq!(error.code, Code::LinkKindMissing);
        assert!(error.remedy.contains("--features ble"), "{error}");
    }
    #[cfg(feature = "ble")]
    {
        let name = "wimu-1a2b".to_owned();
        let link = LinkUrl::Ble { name };
        assert_eq!(link.to_string(), "ble://wimu-1a2b");
        assert_eq!(Input::parse("ble://wimu-1a2b").unwrap(), Input::Link(link));
    }
}
