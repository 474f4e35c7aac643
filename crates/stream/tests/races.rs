use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::limits::OnTimeLimits;
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_api::LatePolicy;
use meissner_array::simulated::PlantConfig;
use meissner_array::strokes::Strokes;
use meissner_stream::device::mock::Mock;
use meissner_stream::link::LineRate;
use meissner_stream::queues::{At, Command, CommandError, End, Play, Request, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Line, Settings, Streamer};
use meissner_test_support::rig::{self, Rig};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

fn order(rig: &mut Rig, pattern: &str, seconds: Option<f64>, at: At) {
    let play = rig.play(&rig::pattern(pattern), seconds);
    rig.send(Command::Play(Box::new(Play { at, ..play })));
}

/// How many plays have begun and ended.
fn begun_and_ended(notices: &[StreamEvent]) -> (usize, usize) {
    let begun = notices.iter().filter(|notice| matches!(notice, StreamEvent::PlayStarted { .. }));
    (begun.count(), rig::outcomes(notices).len())
}

/// Arms again and lets time pass: nothing that was ordered before may begin.
fn nothing_comes_to_life(rig: &mut Rig) {
    rig.run(10_000 * MS);
    rig.take_events();
    rig.send(Command::Arm { assume_rest: true });
    rig.run(500 * MS);
    assert_eq!(begun_and_ended(&rig.take_events()), (0, 0));
    assert_eq!(rig.mock.controller().state(), State::Armed);
}

#[test]
fn a_play_ordered_after_a_lease_and_a_stop_is_refused_and_stays_dead() {
    let mut rig = Rig::new(Line::default(), 8);
    rig.arm();
    rig.stall(900 * MS);
    rig.send(Command::Stop);
    rig.run(500 * MS);
    rig.take_events();
    order(&mut rig, "pin-60", None, At::Next);
    let refused = |notice: &StreamEvent| {
        matches!(notice, StreamEvent::Answer { result: Err(CommandError::Disarmed), .. })
    };
    assert!(rig.take_events().iter().any(refused));
    nothing_comes_to_life(&mut rig);
}

#[test]
fn a_play_behind_an_arm_that_timed_out_ends_with_it() {
    let mut rig = Rig::new(Line::default(), 23);
    rig.run(500 * MS);
    // A line that grows so slow that no answer comes in time, but not so fast that it seems dead.
    for delay in (0..560).step_by(20) {
        rig.set_line(Line { delay: delay * MS, ..Line::default() });
        rig.run(40 * MS);
    }
    rig.run(1500 * MS);
    rig.send(Command::Arm { assume_rest: true });
    order(&mut rig, "pin-60", None, At::Next);
    rig.run(5000 * MS);
    rig.set_line(Line::default());
    rig.run(1000 * MS);
    assert_eq!(begun_and_ended(&rig.take_events()), (0, 1));
    assert_eq!(rig.mock.controller().state(), State::Disarmed);
    nothing_comes_to_life(&mut rig);
}

#[test]
fn two_arms_in_a_row_leave_it_armed_and_playing() {
    let mut rig = Rig::new(Line::default(), 23);
    rig.run(500 * MS);
    rig.send(Command::Arm { assume_rest: true });
    rig.send(Command::Arm { assume_rest: true });
    order(&mut rig, "pin-60", Some(0.2), At::Next);
    rig.run(1000 * MS);
    let outcomes = rig::into_outcomes(rig.take_events());
    assert_eq!(outcomes.iter().map(|outcome| outcome.end).collect::<Vec<_>>(), [End::Done]);
    order(&mut rig, "pin-60", Some(0.2), At::Next);
    rig.run(1000 * MS);
    assert_eq!(begun_and_ended(&rig.take_events()), (1, 1));
}

#[test]
fn a_device_whose_clock_begins_anew_plays_as_the_one_before() {
    let mut streamer = Streamer::new(Settings::default());
    let (mut notices, mut frame, mut bytes, mut ms) = (Vec::new(), [0; MAX_FRAME], [0; 4096], 0);
    for (boot, start) in [(1, Tick::BOOT + 600 * 85_000), (2, Tick::BOOT)] {
        let mut mock = Mock::starting_at(PlantConfig::default(), boot, start).unwrap();
        let tell = &mut |notice| notices.push(notice);
        streamer.connect(HostInstant::from_ns(ms * 1_000_000), boot, LineRate(800_000), tell);
        for since in 0..3000u64 {
            ms += 1;
            let now = HostInstant::from_ns(ms * 1_000_000);
            mock.run(start + since * 85);
            let len = mock.read(&mut bytes);
            let job = match since {
                200 => Some(Command::Arm { assume_rest: true }),
                400 | 1500 => {
                    let strokes = Strokes::new(&rig::pattern("pin-60"), Some(0.05)).unwrap();
                    let (id, at, late) = (ms, At::Next, LatePolicy::Drop);
                    Some(Command::Play(Box::new(Play {
                        id,
                        strokes,
                        at,
                        late,
                        replace: false,
                        open_loop: true,
                        bandwidth: Bandwidth::default(),
                    })))
                }
                _ => None,
            };
            if let Some(job) = job {
                streamer.execute(now, Request { ticket: ms, issued_at: now, command: job }, tell);
            }
            streamer.receive(now, &bytes[..len], tell);
            streamer.step(now, tell);
            loop {
                let len = streamer.transmit(now, &mut frame, tell);
                if len == 0 {
                    break;
                }
                mock.write(&frame[..len]);
            }
        }
    }
    assert_eq!(begun_and_ended(&notices), (4, 4));
}

#[test]
fn tens_of_thousands_of_reports_later_verdicts_still_count() {
    let settings =
        Settings { limits: OnTimeLimits { motor: 300, ..OnTimeLimits::NONE }, ..Settings::default() };
    let mut rig = Rig::with(settings, Line { delay: 5 * MS, ..Line::default() }, 24);
    rig.arm();
    for round in 0..10 {
        order(&mut rig, "all-in-phase", Some(6.0), At::Next);
        rig.run(7000 * MS);
        rig.mock.take_trace();
        assert_eq!(begun_and_ended(&rig.take_events()), (1, 1), "round {round}");
    }
}

#[test]
fn strokes_refused_as_they_begin_do_not_lead_the_loop_astray() {
    let settings =
        Settings { limits: OnTimeLimits { motor: 1200, ..OnTimeLimits::NONE }, ..Settings::default() };
    let rest = |open_loop| {
        let mut rig = Rig::with(settings, Line::default(), 24);
        rig.arm();
        let play = rig.play(&rig::pattern("edge-45"), Some(5.0));
        rig.send(Command::Play(Box::new(Play { open_loop, ..play })));
        rig.run(6000 * MS);
        assert!(rig::into_outcomes(rig.take_events())[0].bursts.refused > 1000);
        rig.mock.true_positions().rest().rms_um()
    };
    let (open, closed) = (rest(true), rest(false));
    assert!(closed < 0.5 * open && closed < 30.0, "open {open} um, closed {closed} um");
}

#[test]
fn an_onset_that_a_play_before_it_has_run_into_is_given_up() {
    let mut rig = Rig::new(Line { delay: 20 * MS, ..Line::default() }, 24);
    rig.run(1000 * MS);
    rig.send(Command::Arm { assume_rest: true });
    let at = rig.streamer.tick_at(rig.now()).unwrap() + 42_500 + 300;
    order(&mut rig, "pin-60", Some(0.5), At::Next);
    order(&mut rig, "pin-60", Some(0.5), At::Tick(at));
    order(&mut rig, "pin-60", Some(0.5), At::Next);
    rig.run(4000 * MS);
    let outcomes = rig::into_outcomes(rig.take_events());
    let ends: Vec<_> = outcomes.iter().map(|outcome| (outcome.play.id, outcome.end)).collect();
    assert_eq!(ends, [(1, End::Done), (2, End::Aborted), (3, End::Done)]);
    outcomes.iter().for_each(rig::assert_closed);
}
