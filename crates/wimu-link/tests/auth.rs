//! Writes that the owner did not sign are refused, and the owner's pass among them.

use std::collections::BTreeMap;
use std::time::Duration;

use wimu_link::auth::{DeviceKey, KeyState, Lock, Session};
use wimu_link::hello::{LinkRole, WriteAccess};
use wimu_link::message::{Answer, Command, Payload, Refusal, Reply, Request, Settings, Signature};
use wimu_link::requester::Requester;
use wimu_link::responder::{Decision, Responder};
use wimu_link::{Deframer, MAX_FRAME};
use wimu_testkit::{Lane, Random, figure};

const NOW: Duration = Duration::from_secs(1);

fn body(line: &[u8]) -> Vec<u8> {
    let mut deframer = Deframer::new();
    line.iter()
        .find_map(|&byte| Some(deframer.push(byte)?.expect("own frame").body.to_vec()))
        .expect("a frame")
}

fn encoded(request: &Request) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = request.encode(&mut line).expect("room");
    body(&line[..length])
}

fn replied(reply: &Reply) -> Vec<u8> {
    let mut line = [0; MAX_FRAME];
    let length = reply.encode(&mut line).expect("room");
    body(&line[..length])
}

/// A device with both its links, which remembers the writes that it carried out.
struct Device {
    lock: Lock,
    links: [Responder; 2],
    writes: Vec<Command>,
}

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

impl Device {
    fn new(lock: Lock) -> Self {
        Self { lock, links: ROLES.map(Responder::new), writes: Vec::new() }
    }

    /// It starts anew: what is in RAM is gone.
    fn restart(&mut self) {
        self.links = ROLES.map(Responder::new);
        self.lock.boot_count = self.lock.boot_count.map(|count| count + 1);
    }

    fn hear(&mut self, role: LinkRole, request: &[u8]) -> Option<Reply> {
        let link = &mut self.links[usize::from(role != LinkRole::Cable)];
        let mut room = [0; MAX_FRAME];
        let frame = match link.accept(request, &self.lock) {
            Decision::Ignore => return None,
            Decision::Send(frame) => frame,
            Decision::Execute(command) => {
                if command.is_write() {
                    self.writes.push(command);
                }
                let answer: Answer = Answer::Accepted(Payload::None);
                link.reply(&answer, &mut room)
            }
        };
        Some(Reply::decode(&body(frame)).expect("own reply"))
    }
}

/// The owner's host on one link.
struct Owner {
    role: LinkRole,
    key: DeviceKey,
    requester: Requester,
    ids: u32,
}

impl Owner {
    fn new(role: LinkRole, key: DeviceKey, session: u32) -> Self {
        Self { role, key, requester: Requester::new(session), ids: session }
    }

    fn open(&mut self, device: &mut Device) {
        let question = body(self.requester.start(Command::OpenSession, NOW));
        let reply = device.hear(self.role, &question).expect("an answer");
        match self.requester.on_reply(&replied(&reply)) {
            Some(Answer::Accepted(Payload::Session { number, nonce })) => {
                let session = Session {
                    key: self.key,
                    role: self.role,
                    device_id: device.lock.device_id,
                    number,
                    nonce,
                };
                self.ids = self.ids.wrapping_mul(0x9e37_79b9).wrapping_add(1);
                self.requester.sign(session, self.ids);
            }
            other => panic!("{other:?}"),
        }
    }

    /// The body of a signed request.
    fn request(&mut self, command: Command) -> Vec<u8> {
        body(self.requester.start(command, NOW))
    }

    /// Requests a write, in a new session if the old one has ended.
    fn write(&mut self, device: &mut Device, command: Command) -> Answer {
        for _ in 0..3 {
            let request = self.request(command);
            let reply = device.hear(self.role, &request).expect("an answer");
            match self.requester.on_reply(&replied(&reply)).expect("its answer") {
                Answer::Refused(Refusal::SessionEnded | Refusal::WrongSignature) => {
                    self.open(device);
                }
                answer => return answer,
            }
        }
        panic!("no session lasts");
    }
}

fn locked_by(key: DeviceKey) -> Lock {
    Lock { key: KeyState::Set(key), device_id: 0x1234, boot_count: Some(7), entropy: [3; 16] }
}

fn rate(rate_hz: u16) -> Command {
    Command::SetSettings(Settings { rate_hz, ..Settings::default() })
}

/// A random key.
fn random_key(random: &mut Random) -> DeviceKey {
    let mut bytes = [0; 32];
    bytes.copy_from_slice(&random.bytes(32));
    DeviceKey::new(bytes)
}

/// A device, its owner's hosts, and an attacker who overhears all of them.
struct Contest {
    source: Random,
    key: DeviceKey,
    others_key: DeviceKey,
    device: Device,
    /// The owner's host on each link, and a second one on the wireless link.
    owners: [Owner; 3],
    /// What was tried, by kind.
    tried: BTreeMap<&'static str, u64>,
    /// What the attacker has overheard on each link, in this start and before.
    heard: Vec<(LinkRole, Vec<u8>)>,
    /// What the owner has written.
    wanted: Vec<Command>,
}

impl Contest {
    fn new(seed: u64) -> Self {
        let mut source = Random::new(seed);
        let (key, others_key) = (random_key(&mut source), random_key(&mut source));
        let roles = [LinkRole::Cable, LinkRole::Wireless, LinkRole::Wireless];
        let owners = roles.map(|role| Owner::new(role, key, source.bits() as u32));
        let device = Device::new(locked_by(key));
        let (tried, heard, wanted) = Default::default();
        let mut contest = Self { source, key, others_key, device, owners, tried, heard, wanted };
        contest.open_all();
        contest
    }

    fn open_all(&mut self) {
        for owner in &mut self.owners {
            owner.open(&mut self.device);
        }
    }

    fn role(&mut self) -> LinkRole {
        ROLES[self.source.below(2)]
    }

    fn attack(&mut self, kind: &'static str, role: LinkRole, body: &[u8]) {
        self.device.hear(role, body);
        *self.tried.entry(kind).or_default() += 1;
    }

    /// Sends one hostile request.
    fn hostile(&mut self) {
        let role = self.role();
        let choice = self.source.below(10);
        let (kind, body) = match choice {
            0..5 if !self.heard.is_empty() => self.altered(choice),
            _ => self.made(choice, role),
        };
        self.attack(kind, role, &body);
    }

    /// An overheard request, as it was or altered.
    fn altered(&mut self, choice: usize) -> (&'static str, Vec<u8>) {
        let source = &mut self.source;
        let (of, mut body) = self.heard[source.below(self.heard.len())].clone();
        match choice {
            0 => ("replayed", body),
            1 => {
                let bit = source.below(8 * body.len());
                body[bit / 8] ^= 1 << (bit % 8);
                ("with a bit flipped", body)
            }
            2 => {
                body.truncate(source.below(body.len()));
                ("truncated", body)
            }
            3 => {
                let other = ROLES[usize::from(of == LinkRole::Cable)];
                assert!(self.device.hear(other, &body).is_none_or(|reply| refused(&reply)));
                ("cross-link", body)
            }
            _ => {
                // Another command or id under a signature that is right for what it was with.
                let mut request = Request::decode(&body).expect("overheard whole");
                if source.below(2) == 0 {
                    request.command = rate(60_000);
                } else {
                    request.id = request.id.wrapping_add(1 + source.below(9) as u32);
                }
                ("with content exchanged", encoded(&request))
            }
        }
    }

    /// A request that the attacker has made, or the owner for something else.
    fn made(&mut self, choice: usize, role: LinkRole) -> (&'static str, Vec<u8>) {
        let source = &mut self.source;
        let command = rate(60_000);
        match choice {
            5 => {
                // Signed by the owner for another of his devices.
                let mut other = Device::new(Lock { device_id: 0x9999, ..locked_by(self.key) });
                let mut owner = Owner::new(role, self.key, source.bits() as u32);
                owner.open(&mut other);
                ("cross-device", owner.request(command))
            }
            6 => {
                let session = Session {
                    key: self.others_key,
                    role,
                    device_id: self.device.lock.device_id,
                    number: source.below(8) as u32,
                    nonce: [source.bits() as u8; 16],
                };
                let id = source.bits() as u32;
                let (session, signature) = (session.number, session.sign(id, &command));
                ("of another key", encoded(&Request { session, id, signature, command }))
            }
            7 => {
                let (session, signature) = (source.bits() as u32, Signature::NONE);
                let command = Command::OpenSession;
                let request = Request { session, id: 1, signature, command };
                ("sessions opened without a key", encoded(&request))
            }
            8 => {
                // The owner's next write, held back, with some of its signature only.
                let owner = &mut self.owners[source.below(3)];
                let cut = with_signature_cut(&owner.request(command), source.below(8));
                self.device.hear(owner.role, &cut);
                ("with the signature cut short", cut)
            }
            _ => ("forged", self.forged()),
        }
    }

    fn forged(&mut self) -> Vec<u8> {
        let source = &mut self.source;
        let request = Request {
            session: source.below(12) as u32,
            id: source.bits() as u32,
            signature: match source.below(3) {
                0 => Signature::NONE,
                1 => Signature::new(&source.bits().to_le_bytes()[..4]).expect("short"),
                _ => Signature::new(&source.bits().to_le_bytes()).expect("whole"),
            },
            command: match source.below(4) {
                0 => Command::FactoryReset,
                1 => Command::SetKey(self.others_key),
                2 => Command::ForgetKey,
                _ => rate(60_000),
            },
        };
        encoded(&request)
    }

    /// Sends what was held back until its session had ended.
    fn send_late(&mut self) {
        let role = self.role();
        let held = held_back_until_others_came(&mut self.device, role, self.key, &mut self.source);
        for late in held {
            self.attack("of sessions pushed out", role, &late);
        }
        assert_eq!(self.device.writes, self.wanted, "a write of an ended session passed");
    }

    /// The owner gets through, from two hosts on one link and one on the other.
    fn owner_writes(&mut self, value: u16) {
        let which = self.source.below(3);
        self.write(which, value);
        // Overheard, with its number and signature.
        let owner = &mut self.owners[which];
        let (role, next) = (owner.role, owner.request(rate(60_001)));
        if self.source.below(4) == 0 {
            // Held back by the attacker, and let through when a later one has passed.
            self.write(which, value);
            self.attack("reordered", role, &next);
        } else {
            self.device.hear(role, &next);
            self.wanted.push(rate(60_001));
        }
        assert_eq!(self.device.writes, self.wanted);
        self.heard.push((role, next));
        if self.heard.len() > 400 {
            self.heard.swap_remove(self.source.below(400));
        }
    }

    fn write(&mut self, which: usize, value: u16) {
        let answer = self.owners[which].write(&mut self.device, rate(value));
        assert_eq!(answer, Answer::Accepted(Payload::None));
        self.wanted.push(rate(value));
        assert_eq!(self.device.writes, self.wanted);
    }

    /// After a restart everything overheard is of an old start, and of sessions that have ended.
    fn restart(&mut self) {
        self.device.restart();
        let heard = self.heard.clone();
        for (role, body) in &heard {
            self.attack("cross-boot", *role, body);
        }
        self.open_all();
        for (role, body) in &heard {
            self.attack("old-session", *role, body);
        }
        assert_eq!(self.device.writes, self.wanted, "a write of an old session passed");
    }
}

/// Attacks on one device while its owner writes on both links; what was tried, by kind. Panics when
/// a write passes that the owner did not ask for, when one passes twice, or when the owner's do not.
fn attack(seed: u64, rounds: usize) -> BTreeMap<&'static str, u64> {
    const HOSTILE_PER_ROUND: usize = 60;
    let mut contest = Contest::new(seed);
    for round in 0..rounds {
        let before = contest.device.writes.len();
        for _ in 0..HOSTILE_PER_ROUND {
            contest.hostile();
        }
        assert_eq!(contest.device.writes.len(), before, "a write passed in round {round}");
        if round % 20 == 19 {
            contest.send_late();
        }
        contest.owner_writes((round % 50_000 + 1) as u16);
        if round % 50 == 49 {
            contest.restart();
        }
        if contest.wanted.len() > 1000 {
            contest.wanted.clear();
            contest.device.writes.clear();
        }
    }
    contest.tried
}

/// The same request with the first bytes of its signature alone.
fn with_signature_cut(body: &[u8], bytes: usize) -> Vec<u8> {
    let mut request = Request::decode(body).expect("own request");
    let whole = request.signature;
    request.signature = Signature::new(&whole.as_bytes()[..bytes]).expect("shorter");
    encoded(&request)
}

/// The owner's writes of two sessions, never delivered, when both sessions have ended: one had not
/// been used when a later one was, four others have been used since the other.
fn held_back_until_others_came(
    device: &mut Device,
    role: LinkRole,
    key: DeviceKey,
    source: &mut Random,
) -> [Vec<u8>; 2] {
    let mut open = |device: &mut Device| {
        let mut owner = Owner::new(role, key, source.bits() as u32);
        owner.open(device);
        owner
    };
    let use_it = |device: &mut Device, owner: &mut Owner| {
        let answer = owner.write(device, Command::GetSettings);
        assert_eq!(answer, Answer::Accepted(Payload::None));
    };
    let mut unused = open(device);
    let mut used = open(device);
    use_it(device, &mut used);
    let held = [&mut unused, &mut used].map(|owner| owner.request(rate(60_000)));
    for _ in 0..4 {
        let mut other = open(device);
        use_it(device, &mut other);
    }
    held
}

fn refused(reply: &Reply) -> bool {
    matches!(reply.answer, Answer::Refused(_) | Answer::Unknown)
}

#[test]
fn nothing_passes_that_the_owner_did_not_sign_and_everything_that_he_did() {
    let (seeds, rounds) = match Lane::current() {
        Lane::Check => (1, 100),
        Lane::Test => (1, 2000),
        Lane::Campaign => (8, 2500),
    };
    let mut all: BTreeMap<&'static str, u64> = BTreeMap::new();
    for seed in 1..=seeds {
        // Asserts that no attack passes and that the owner gets through after each round.
        for (kind, count) in attack(99 + seed, rounds) {
            *all.entry(kind).or_default() += count;
        }
    }
    for (kind, count) in &all {
        println!("{count:>9} {kind}");
    }
    let total: u64 = all.values().sum();
    figure(
        "unsigned, replayed, altered or held-back requests accepted",
        format!("0 of {total}"),
        "none",
        true,
    );
    assert!(all.len() >= 14, "{all:?}");
    let least = (seeds as usize * rounds / 10) as u64;
    assert!(all.values().all(|&count| count >= least), "{all:?}");
}

#[test]
fn opening_sessions_without_the_key_ends_nobodys() {
    let key = DeviceKey::new([5; 32]);
    let mut device = Device::new(locked_by(key));
    let mut owner = Owner::new(LinkRole::Wireless, key, 1);
    owner.open(&mut device);
    let open = |device: &mut Device, from: u32| {
        for session in from..from + 10_000 {
            let request = Request {
                session,
                id: 1,
                signature: Signature::NONE,
                command: Command::OpenSession,
            };
            let reply = device.hear(LinkRole::Wireless, &encoded(&request));
            assert!(matches!(
                reply.map(|reply| reply.answer),
                Some(Answer::Accepted(Payload::Session { .. }))
            ));
        }
    };
    // Between opening and the first signed request, and between two of those.
    for from in [1_000_000, 2_000_000] {
        open(&mut device, from);
        let request = owner.request(rate(200));
        let reply = device.hear(LinkRole::Wireless, &request).expect("an answer");
        let answer = owner.requester.on_reply(&replied(&reply));
        assert_eq!(answer, Some(Answer::Accepted(Payload::None)));
    }
}

#[test]
fn a_signature_that_is_not_whole_is_none() {
    let key = DeviceKey::new([5; 32]);
    let mut device = Device::new(locked_by(key));
    for role in ROLES {
        let mut owner = Owner::new(role, key, 77);
        owner.open(&mut device);
        let whole = owner.request(rate(200));
        for bytes in 0..8 {
            let cut = with_signature_cut(&whole, bytes);
            let reply = device.hear(role, &cut).expect("an answer");
            let refusal = match bytes {
                0 => Refusal::SignatureNeeded,
                _ => Refusal::WrongSignature,
            };
            assert_eq!(reply.answer, Answer::Refused(refusal), "{bytes} bytes");
        }
        assert_eq!(device.writes, []);
        let reply = device.hear(role, &whole).expect("an answer");
        assert_eq!(reply.answer, Answer::Accepted(Payload::None));
        device.writes.clear();
        // Nor is that of an answer.
        let cut = Reply {
            signature: Signature::new(&reply.signature.as_bytes()[..7]).expect("shorter"),
            ..reply
        };
        assert_eq!(owner.requester.on_reply(&replied(&cut)), None);
        assert!(owner.requester.on_reply(&replied(&reply)).is_some());
        assert!(owner.requester.is_authenticated());
    }
}

#[test]
fn sessions_end_when_others_have_taken_their_place() {
    let key = DeviceKey::new([5; 32]);
    let mut device = Device::new(locked_by(key));
    for role in ROLES {
        for late in held_back_until_others_came(&mut device, role, key, &mut Random::new(3)) {
            let reply = device.hear(role, &late).expect("an answer");
            assert_eq!(reply.answer, Answer::Refused(Refusal::SessionEnded));
        }
    }
    assert_eq!(device.writes, []);
}

#[test]
fn a_session_is_another_one_in_every_respect() {
    let lock = locked_by(DeviceKey::new([5; 32]));
    let nonces = |lock: Lock, role: LinkRole, opened: usize| {
        let mut device = Device::new(lock);
        let mut last = None;
        for session in 0..opened {
            let request = Request {
                session: session as u32,
                id: 1,
                signature: Signature::NONE,
                command: Command::OpenSession,
            };
            last = device.hear(role, &encoded(&request)).map(|reply| reply.answer);
        }
        match last {
            Some(Answer::Accepted(Payload::Session { nonce, .. })) => nonce,
            other => panic!("{other:?}"),
        }
    };
    let all = [
        nonces(lock, LinkRole::Wireless, 1),
        nonces(lock, LinkRole::Wireless, 2),
        nonces(lock, LinkRole::Cable, 1),
        nonces(Lock { boot_count: Some(8), ..lock }, LinkRole::Wireless, 1),
        nonces(Lock { entropy: [4; 16], ..lock }, LinkRole::Wireless, 1),
        nonces(locked_by(DeviceKey::new([6; 32])), LinkRole::Wireless, 1),
    ];
    for (place, nonce) in all.iter().enumerate() {
        assert!(all[..place].iter().all(|other| other != nonce));
    }
}

#[test]
fn an_answer_that_the_device_did_not_sign_is_none() {
    let key = DeviceKey::new([5; 32]);
    let mut device = Device::new(locked_by(key));
    let mut owner = Owner::new(LinkRole::Wireless, key, 1);
    owner.open(&mut device);
    let first = owner.request(rate(100));
    let old = device.hear(LinkRole::Wireless, &first).expect("an answer");
    assert!(owner.requester.on_reply(&replied(&old)).is_some());
    let second = owner.request(rate(200));
    let right = device.hear(LinkRole::Wireless, &second).expect("an answer");
    for wrong in [
        old,
        Reply { id: right.id, ..old },
        Reply { signature: Signature::NONE, ..right },
        Reply { answer: Answer::Unknown, ..right },
        Reply { signature: Signature::new(&[0; 8]).expect("whole"), ..right },
        Reply {
            signature: Signature::NONE,
            answer: Answer::Refused(Refusal::StoreFailed),
            ..right
        },
    ] {
        assert_eq!(owner.requester.on_reply(&replied(&wrong)), None, "{wrong:?}");
    }
    assert!(owner.requester.on_reply(&replied(&right)).is_some());
}

#[test]
fn keys_are_changed_over_the_cable_only_and_by_who_has_the_one_before() {
    let (key, new) = (DeviceKey::new([5; 32]), DeviceKey::new([6; 32]));
    let mut device = Device::new(locked_by(key));
    for role in ROLES {
        let mut owner = Owner::new(role, key, 1);
        owner.open(&mut device);
        for command in [Command::SetKey(new), Command::ForgetKey] {
            let answer = owner.write(&mut device, command);
            let expected = match role {
                LinkRole::Cable => Answer::Accepted(Payload::None),
                _ => Answer::Refused(Refusal::CableOnly),
            };
            assert_eq!(answer, expected, "{role} {command:?}");
        }
    }
    // What was signed with the old key is worth nothing under the new one.
    let mut owner = Owner::new(LinkRole::Cable, key, 9);
    owner.open(&mut device);
    let old = owner.request(Command::FactoryReset);
    device.lock.key = KeyState::Set(new);
    let reply = device.hear(LinkRole::Cable, &old).expect("an answer");
    assert_eq!(reply.answer, Answer::Refused(Refusal::WrongSignature));
}

#[test]
fn the_key_is_never_shown() {
    let key = DeviceKey::new([0xAB; 32]);
    let shown = format!("{key:?} {:?} {:?}", <Command>::SetKey(key), KeyState::Set(key));
    assert!(!shown.contains("171") && !shown.to_lowercase().contains("ab, "), "{shown}");
    assert_eq!(key.id().to_string().len(), 8);
}

#[test]
fn a_key_of_another_length_is_no_command() {
    let mut device =
        Device::new(Lock { key: KeyState::None, ..locked_by(DeviceKey::new([0; 32])) });
    let whole = encoded(&Request {
        session: 1,
        id: 1,
        signature: Signature::NONE,
        command: Command::SetKey(DeviceKey::new([1; 32])),
    });
    for (id, length) in (2..).zip([0, 1, 31, 33]) {
        let mut body = whole[..whole.len() - 32].to_vec();
        body[1] = id;
        body.extend(vec![1; length]);
        let reply = device.hear(LinkRole::Cable, &body).expect("an answer");
        assert_eq!(reply.answer, Answer::Unknown, "{length}");
    }
    assert_eq!(device.writes, []);
}

#[test]
fn a_device_that_cannot_read_its_boot_count_takes_a_new_key_over_the_cable_and_no_other_write() {
    let (key, new) = (DeviceKey::new([5; 32]), DeviceKey::new([6; 32]));
    let lock = Lock { boot_count: None, entropy: [0; 16], ..locked_by(key) };
    for (role, command) in [
        (LinkRole::Wireless, Command::OpenSession),
        (LinkRole::Wireless, rate(100)),
        (LinkRole::Wireless, Command::SetKey(new)),
        (LinkRole::Cable, rate(100)),
        (LinkRole::Cable, Command::SetKey(new)),
    ] {
        assert_eq!(lock.access(role), WriteAccess::Locked);
        let request = Request { session: 1, id: 1, signature: Signature::NONE, command };
        let mut device = Device::new(lock);
        let reply = device.hear(role, &encoded(&request)).expect("an answer");
        let over_the_air = role != LinkRole::Cable && command != rate(100);
        let refusal = if over_the_air && command != Command::OpenSession {
            Refusal::CableOnly
        } else {
            Refusal::Locked
        };
        assert_eq!(reply.answer, Answer::Refused(refusal), "{role} {command:?}");
        assert_eq!(device.writes, []);
    }
    // Over the cable the owner gets an authenticated answer and sets a new key.
    let mut device = Device::new(lock);
    let mut owner = Owner::new(LinkRole::Cable, key, 1);
    owner.open(&mut device);
    let mut recorded: Vec<Vec<u8>> = Vec::new();
    for command in [rate(100), Command::FactoryReset, Command::ForgetKey] {
        let request = owner.request(command);
        let reply = device.hear(LinkRole::Cable, &request).expect("an answer");
        let answer = owner.requester.on_reply(&replied(&reply));
        assert_eq!(answer, Some(Answer::Refused(Refusal::Locked)));
        assert!(owner.requester.is_authenticated());
        recorded.push(request);
    }
    assert_eq!(device.writes, []);
    let answer = owner.write(&mut device, Command::SetKey(new));
    assert_eq!(answer, Answer::Accepted(Payload::None));
    // Without entropy what he has signed is as well signed in the next start, and refused again.
    let mut device = Device::new(lock);
    Owner::new(LinkRole::Cable, key, 2).open(&mut device);
    for request in &recorded {
        let reply = device.hear(LinkRole::Cable, request).expect("an answer");
        assert_eq!(reply.answer, Answer::Refused(Refusal::Locked));
        assert_ne!(reply.signature, Signature::NONE);
    }
    assert_eq!(device.writes, []);
}

/// Against Python's `hmac` and `hashlib`.
#[test]
fn signatures_are_those_of_an_independent_implementation() {
    let key = DeviceKey::new(core::array::from_fn(|at| at as u8));
    assert_eq!(key.id().to_string(), "2661c013");
    let mut device = Device::new(locked_by(key));
    let role = LinkRole::Wireless;
    let open =
        Request { session: 9, id: 1, signature: Signature::NONE, command: Command::OpenSession };
    let reply = device.hear(role, &encoded(&open)).expect("an answer");
    let nonce = [
        0x6a, 0xd5, 0xa7, 0xeb, 0x3e, 0x45, 0x6f, 0x43, 0xa7, 0x29, 0x8c, 0xda, 0x0e, 0xae, 0x66,
        0x3b,
    ];
    let session = Payload::Session { number: 1, nonce };
    assert_eq!(reply.answer, Answer::Accepted(session));
    let request = Request {
        session: 1,
        id: 0xffff_fffe,
        signature: Signature::new(&[0x31, 0x03, 0xef, 0x4b, 0xe3, 0x41, 0x04, 0xe8])
            .expect("whole"),
        command: Command::FactoryReset,
    };
    let reply = device.hear(role, &encoded(&request)).expect("an answer");
    assert_eq!(reply.answer, Answer::Accepted(Payload::None));
    let signature = [0x58, 0xf6, 0xc8, 0xdd, 0x0d, 0xed, 0xc1, 0x8a];
    assert_eq!(reply.signature.as_bytes(), signature);
}
