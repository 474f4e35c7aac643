use crate::bench::{Bench, FIRMWARE, PAPER, TICK_HZ, stroke};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{MAX_BATCH, longest_frame, moves};
use firmware_protocol::board::{Board, Counts, Measures, Outputs, Reset, SelfTest, SelfTestState};
use firmware_protocol::frame::{Decoder, MAX_FRAME, read};
use firmware_protocol::message::{Cause, DeviceMessage, HostMessage, Op, State};
use firmware_protocol::tick::Tick;

impl Bench {
    /// Asks for a board report, and returns the only answer.
    fn ask(&mut self, window: u16) -> Board {
        self.drain();
        let before = self.inbox.len();
        self.send(&HostMessage::Board { window });
        match &self.inbox[before..] {
            [DeviceMessage::Board(board)] => *board,
            other => panic!("one board report, not {other:?}"),
        }
    }

    /// Asks for a self-test, and returns the only answer.
    fn ask_test(&mut self, run: u16) -> SelfTestState {
        let before = self.inbox.len();
        self.send(&HostMessage::SelfTest { run });
        self.state_of(before, run)
    }

    fn state_of(&self, before: usize, run: u16) -> SelfTestState {
        let states: Vec<_> = self.inbox[before..]
            .iter()
            .filter_map(|message| match message {
                DeviceMessage::SelfTest { run: of, state } if *of == run => Some(*state),
                _ => None,
            })
            .collect();
        let [state] = states[..] else { panic!("one state, not {states:?}") };
        state
    }
}

#[test]
fn windows_of_slack_follow_each_other_whatever_is_lost() {
    let mut bench = Bench::new(FIRMWARE);
    bench.hello(1);
    assert_eq!(bench.ask(7).slack, None, "nothing was rendered");
    bench.device.rendered_with(30);
    bench.device.rendered_with(26);
    bench.device.rendered_with(40);
    let board = bench.ask(8);
    assert_eq!((board.window, board.slack, board.slack_since_boot), (8, Some(26), Some(26)));
    bench.device.rendered_with(35);
    // The answer was lost: its repetition has the same window.
    assert_eq!(bench.ask(8).slack, Some(26));
    assert_eq!((bench.ask(9).slack, bench.ask(10).slack), (Some(35), None));
    bench.device.rendered_with(300);
    bench.hello(2);
    let board = bench.ask(10);
    assert_eq!((board.slack, board.slack_since_boot), (Some(255), Some(26)), "a new session asks anew");
}

const HIGH: Outputs = Outputs { lines: MotorSet::from_bits(4), trigger: true, enable: false };

#[test]
fn a_report_says_what_the_shell_measured_and_what_failed() {
    let mut bench = Bench::armed(FIRMWARE);
    let counts = Counts { stalls: Some(2), usb_recoveries: Some(3), output_faults: 0 };
    let measures = Measures { reset: Reset::RunPin, counts, high_at_boot: Some(HIGH) };
    assert!(!bench.device.wants_measures());
    bench.device.measured(measures);
    bench.run(u64::from(TICK_HZ) * 3 / 2);
    let board = bench.ask(1);
    assert_eq!((board.reset, board.counts, board.high_at_boot), (Reset::RunPin, counts, Some(HIGH)));
    assert_eq!(board.uptime_s, 1);
    bench.device.fault(Tick(bench.now), Cause::Starved);
    bench.device.fault(Tick(bench.now), Cause::Output);
    assert_eq!(bench.ask(2).counts.output_faults, 1, "it was off already");
    bench.control(Op::Reset);
    bench.control(Op::EStop);
    assert_eq!(bench.ask(3).counts.output_faults, 1, "an e-stop is no fault");
}

#[test]
fn a_self_test_is_for_a_disarmed_device_and_once_per_number() {
    let mut bench = Bench::armed(FIRMWARE);
    assert_eq!(bench.ask_test(1), SelfTestState::Refused);
    bench.control(Op::Disarm(Cause::Request));
    bench.settle();
    assert_eq!(bench.ask_test(1), SelfTestState::Refused, "the same number does not begin one");
    assert_eq!(bench.ask_test(2), SelfTestState::Running);
    assert!(bench.device.is_testing());
    let result = SelfTest { work_us: Some(158), ..SelfTest::default() };
    let before = bench.inbox.len();
    bench.device.tested(result);
    bench.drain();
    assert_eq!(bench.state_of(before, 2), SelfTestState::Done(result));
    assert_eq!(bench.ask_test(2), SelfTestState::Done(result), "the first answer was lost");
    assert!(!bench.device.is_testing());
    bench.control(Op::EStop);
    assert_eq!(bench.ask_test(3), SelfTestState::Refused, "the lines are forced low");
}

/// Commands, e-stops, faults, a lost link and another host.
#[test]
fn what_matters_more_ends_a_self_test() {
    type Act = fn(&mut Bench);
    let acts: [(&str, Act, State); 6] = [
        ("arm", |bench| bench.arm(true), State::Armed),
        ("e-stop", |bench| bench.control(Op::EStop), State::Faulted),
        ("found e-stop", |bench| bench.device.e_stop(Tick(bench.now), 9), State::Faulted),
        ("fault", |bench| bench.device.output_failed(Tick(bench.now)), State::Faulted),
        ("lost link", |bench| bench.device.link_lost(Tick(bench.now)), State::Disarmed),
        ("another host", |bench| bench.hello(5), State::Disarmed),
    ];
    for (what, act, state) in acts {
        let mut bench = Bench::new(FIRMWARE);
        bench.hello(1);
        assert_eq!(bench.ask_test(1), SelfTestState::Running);
        act(&mut bench);
        assert!(!bench.device.is_testing() && bench.device.state() == state, "{what}");
        bench.device.tested(SelfTest::default());
        if !matches!(what, "lost link" | "another host") {
            assert_eq!(bench.ask_test(1), SelfTestState::Ended, "{what}");
        }
        if state == State::Armed {
            let up = bench.soon();
            bench.strokes(&[stroke(0, up, 10, 0, 10)]);
            bench.run_to(up + 100);
            assert_eq!(bench.device.counters().pulses, 20);
        }
    }
}

#[test]
fn the_longest_frame_is_one() {
    let mut out = [0; MAX_FRAME];
    let len = longest_frame(&PAPER, &mut out);
    let mut decoder = Decoder::new();
    let body = decoder.next(&mut &out[..len]).expect("a whole frame");
    let Ok(HostMessage::Moves { batch, base, .. }) = read(body) else { panic!("moves") };
    let moves = moves(base.near(Tick(0)), batch).expect("a batch").len();
    assert!(moves == MAX_BATCH && len > 200, "{moves} moves in {len} bytes");
}
