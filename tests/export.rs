use crate::harness::{Daemon, TIMEOUT, began, complaint, document, ended, printed, problem};
use crate::sessions::{exported, owner};
use meissner_api::{Event, Receipt, Session, Status};
use meissner_client::{Client, Events};
use serde_json::{Value, json};
use std::fs;

#[test]
fn an_export_has_one_row_per_play() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let mut receipts = Vec::new();
    for (trial, label) in [(1, "a"), (2, "b, \"c\"")] {
        let play =
            json!({"pattern": "pin-60", "seconds": 0.1, "trial": trial, "labels": {"condition": label}});
        let _: Value = client.post("/v1/play", &play).unwrap();
        receipts.push(ended(&mut events));
    }
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    began(&mut events);
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    receipts.push(ended(&mut events));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    // This play does not belong to the session.
    client.set_token(None);
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    ended(&mut events);
    let file = daemon.path("session.csv");
    printed(daemon.meissner().args(["session", "export", &started.id, "-o"]).arg(&file));
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(text, printed(daemon.meissner().args(["session", "export", &started.id])));
    let link = daemon.path("link.csv");
    std::os::unix::fs::symlink(&file, &link).unwrap();
    let refused = complaint(daemon.meissner().args(["session", "export", &started.id, "-o"]).arg(&link));
    assert!(refused.contains("is not a regular file"), "{refused}");
    assert!(link.is_symlink() && fs::read_to_string(&file).unwrap() == text);
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head = table.headers().unwrap().clone();
    let rows: Vec<_> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), receipts.len(), "{text}");
    for (row, receipt) in rows.iter().zip(&receipts) {
        let of = |name: &str| row[head.iter().position(|column| column == name).unwrap()].to_owned();
        let (onset, bursts) = (receipt.onset.unwrap(), receipt.bursts.unwrap());
        assert_eq!(
            (of("session"), of("participant"), of("seed")),
            (started.id.clone(), "P07".into(), "7".into())
        );
        assert_eq!((of("session_labels"), of("play")), ("block=2".into(), receipt.id.to_string()));
        assert_eq!(of("trial"), receipt.trial.map_or_else(String::new, |trial| trial.to_string()));
        let label =
            receipt.labels.get("condition").map_or_else(String::new, |label| format!("condition={label}"));
        assert_eq!((of("labels"), of("pattern_sha256")), (label, receipt.pattern_sha256.clone()));
        assert_eq!(
            (of("onset_tick"), of("onset_monotonic_ns")),
            (onset.actual_tick.to_string(), onset.monotonic_ns.to_string())
        );
        assert_eq!(
            (of("bursts_planned"), of("bursts_played")),
            (bursts.planned.to_string(), bursts.played.to_string())
        );
        assert_eq!(
            (of("state"), of("cause")),
            (
                receipt.state.name().into(),
                receipt.cause.as_ref().map_or_else(String::new, ToString::to_string)
            )
        );
        assert!(of("reported_after_s").parse::<f64>().unwrap() < 20.0 && !of("session_ended").is_empty());
    }
    // The line of a play's end is lost: the export keeps the play and names the damage.
    daemon.wait_for_record();
    let folder = daemon.path("state/meissner/logbook");
    let day = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
    let day =
        day.into_iter().find(|file| file.extension().is_some_and(|extension| extension == "jsonl")).unwrap();
    let text = fs::read_to_string(&day).unwrap();
    let damaged: String = text
        .lines()
        .map(|line| {
            if line.contains("\"event\":\"ended\"") && line.contains("\"id\":2,") { "{\"tor\n" } else { line }
        })
        .map(|line| format!("{}\n", line.trim_end()))
        .collect();
    fs::write(&day, damaged).unwrap();
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(line.contains("1 of 3 plays are missing") && line.contains("--incomplete"), "{line}");
    let (exported, warning) = exported(&daemon, &started.id);
    let states: Vec<_> =
        exported["plays"].as_array().unwrap().iter().map(|play| (&play["play"], &play["state"])).collect();
    assert_eq!(
        states,
        [(&json!(1), &json!("done")), (&json!(3), &json!("stopped")), (&json!(2), &json!("unknown"))]
    );
    assert!(
        // The line, and the gap that it leaves in the numbers.
        exported["unreadable"] == 2 && warning.contains(".jsonl:") && warning.contains("not a line of JSON"),
        "{warning}"
    );
    assert!(
        complaint(daemon.meissner().args(["session", "export", "20200101T000000Z-000000"]))
            .contains("is recorded")
    );
}

/// An answer may come before the end of its play, or after; what is no play of the session has none.
#[test]
fn answers_of_the_participant_stand_in_the_rows_of_their_plays() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", true);
    let mut events = client.events().unwrap();
    let item = json!({"pattern": "pin-60", "seconds": 0.05, "gap_ms": 10});
    let plays = [
        ("/v1/play", json!({"pattern": "pin-60", "seconds": 0.1})),
        ("/v1/sequence", json!({"items": [item, item]})),
        ("/v1/play", json!({"pattern": "pin-60", "seconds": 0.1})),
    ];
    for (path, play) in &plays {
        let _: Value = client.post(path, play).unwrap();
        ended(&mut events);
    }
    let endless: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    assert_eq!(began(&mut events), 4, "{endless}");
    let response = format!("\ta\r\nb\0{}", "x".repeat(2000));
    let whole = json!({"response": response, "correct": true, "rt_ms": 512.5, "level": -0.4, "factors": {"b": "2", "a": "1"}});
    for (play, answer) in [
        (4, json!({"response": "right", "correct": false, "factors": {"c": "x, y"}})),
        (1, whole.clone()),
        (2, json!({"response": "2", "correct": null})),
    ] {
        assert_eq!(client.post::<Value>(&format!("/v1/plays/{play}/answer"), &answer).unwrap(), json!({}));
    }
    let refused = |client: &mut Client, play: &str, answer: &Value| {
        let problem = problem(client.post(&format!("/v1/plays/{play}/answer"), answer));
        assert!(!problem.detail.contains('\n'));
        (problem.code, problem.detail)
    };
    let once = refused(&mut client, "1", &whole);
    assert_eq!(
        once,
        ("exists".to_owned(), "play 1 has an answer already: a play has one at most".to_owned())
    );
    assert_eq!(refused(&mut client, "3", &json!({"response": "x".repeat(8192)})).0, "bad-request");
    assert_eq!(client.post::<Value>("/v1/plays/3/answer", &json!({"response": ""})).unwrap(), json!({}));
    assert_eq!(refused(&mut client, "77", &whole).0, "not-found");
    assert_eq!(refused(&mut client, "last", &whole).0, "bad-request");
    // Only the owner of an exclusive session.
    assert_eq!(refused(&mut daemon.client(), "3", &whole).0, "session-exclusive");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    client.set_token(None);
    let over = refused(&mut client, "3", &whole);
    assert_eq!(over.0, "session-running", "{}", over.1);
    let text = printed(daemon.meissner().args(["session", "export", &started.id]));
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head: Vec<_> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let answer = ["response", "correct", "response_time", "level", "factor_a", "factor_b", "factor_c"];
    let places = answer.map(|name| head.iter().position(|column| column == name).unwrap());
    assert!(head.ends_with(&["factor_a", "factor_b", "factor_c"].map(str::to_owned)), "{head:?}");
    let rows: Vec<Vec<String>> = table
        .records()
        .map(|row| {
            let row = row.unwrap();
            places.iter().map(|&place| row[place].to_owned()).collect()
        })
        .collect();
    let of_sequence = ["2", "", "", "", "", "", ""];
    assert_eq!(
        rows,
        [
            [&*response, "true", "0.5125", "-0.4", "1", "2", ""],
            of_sequence,
            of_sequence,
            ["\"\"", "", "", "", "", "", ""],
            ["right", "false", "", "", "", "", "x, y"]
        ]
    );
    let (exported, _) = exported(&daemon, &started.id);
    let answers: Vec<_> = exported["plays"].as_array().unwrap().iter().map(|play| &play["answer"]).collect();
    let silent = json!({"response": "", "correct": null, "factors": {}});
    assert_eq!((answers.len(), answers[0], answers[4]), (6, &whole, &silent));
}

#[test]
fn the_command_line_records_an_answer() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    ended(&mut events);
    let answer = "answer 1 -3 --wrong --rt-ms 20.5 --level -1.5 --factor block=2";
    assert_eq!(printed(daemon.meissner().args(answer.split(' '))).trim(), "play 1: answer recorded");
    assert!(complaint(daemon.meissner().args(["answer", "1", "left"])).contains("has an answer already"));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let (exported, _) = exported(&daemon, &started.id);
    assert_eq!(
        exported["plays"][0]["answer"],
        json!({"response": "-3", "correct": false, "rt_ms": 20.5, "level": -1.5, "factors": {"block": "2"}})
    );
}

/// Each stimulus has a row; events and record have every item that began.
#[test]
fn an_export_has_a_row_for_each_item_of_a_sequence() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let item = json!({"pattern": "pin-60", "seconds": 0.02, "gap_ms": 10, "scale": 0.5, "trigger": {"code": 9, "width_ms": 1}});
    let items = vec![item; 40];
    let sequence = json!({"items": items, "trial": 4, "labels": {"block": "1"}, "name": "taps"});
    let _: Value = client.post("/v1/sequence", &sequence).unwrap();
    let mut told = Vec::new();
    let receipt = next_ended(&mut events, |event| {
        if let Event::Items { first, items, session, .. } = event {
            assert_eq!((first, session.as_deref()), (told.len(), Some(&*started.id)));
            told.extend(items);
        }
    });
    let whole: Receipt = client.get(&format!("/v1/plays/{}", receipt.id)).unwrap();
    let records = whole.items.clone().unwrap();
    assert_eq!(told, *records);
    // For a stopped sequence, the export has the items that began.
    let _: Value = client.post("/v1/sequence", &sequence).unwrap();
    began(&mut events);
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    let mut begun = 0;
    next_ended(&mut events, |event| {
        if let Event::Items { items, .. } = event {
            begun += items.len();
        }
    });
    assert!(begun < 40);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let text = printed(daemon.meissner().args(["session", "export", &started.id]));
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head = table.headers().unwrap().clone();
    let rows: Vec<_> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 40 + begun.max(1), "{text}");
    for (number, (row, record)) in rows.iter().zip(records.iter()).enumerate() {
        let of = |name: &str| row[head.iter().position(|column| column == name).unwrap()].to_owned();
        let (onset, offset) = (record.onset.unwrap(), record.offset.unwrap());
        let tick = onset.tick.to_string();
        assert_eq!(
            (of("item"), of("pattern"), of("trial")),
            (number.to_string(), "pin-60".into(), "4".into())
        );
        assert_eq!(
            (of("onset_tick"), of("trigger_tick"), of("trigger_code")),
            (tick.clone(), tick, "9".into())
        );
        assert_eq!((of("offset_tick"), of("state")), (offset.tick.to_string(), "played".into()));
        assert_eq!(
            (of("scale"), of("ordered_ms"), of("labels")),
            ("0.5".into(), "20".into(), "block=1".into())
        );
        let [ordered, reached, played] =
            ["ordered_um", "reached_um", "played_ms"].map(|name| of(name).parse::<f64>().unwrap());
        assert!(ordered > 0.0 && reached > 0.8 * ordered && played > 10.0 && played <= 20.0, "{text}");
        let wall: i64 = of("onset_wall_ns").parse().unwrap();
        let first: i64 =
            rows[0][head.iter().position(|column| column == "onset_wall_ns").unwrap()].parse().unwrap();
        assert!((wall - first - 30_000_000 * number as i64).abs() < 1_000_000);
    }
    let exported = document(daemon.meissner().args(["session", "export", &started.id, "--json"]));
    assert_eq!(
        (&exported["plays"][0]["items"], &exported["plays"][0]["pattern"]),
        (&json!(40), &json!("taps"))
    );
    assert_eq!((&exported["plays"][1]["item"], &exported["lost"]), (&json!(0), &json!(0)));
    // The boot from the mock's handshake.
    assert!(exported["plays"][1]["boot"].is_u64() && exported["plays"][1]["pattern_kept"] == true);
}

/// The next receipt; `see` gets the events before it.
fn next_ended(events: &mut Events, mut see: impl FnMut(Event)) -> Receipt {
    loop {
        match events.next(Some(TIMEOUT)).unwrap().unwrap() {
            Event::Ended { receipt } => return *receipt,
            event => see(event),
        }
    }
}
