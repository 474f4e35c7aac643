//! Recorded plays of a session as they are exported: a row for each play and each item of a sequence; a damaged record.

use super::bench::{Bench, Client, Events, began, ended, next, problem};
use super::sessions::owner;
use crate::cli::export::table;
use meissner_api::{Event, Receipt, Session, SessionList, SessionPlays, Status};
use serde_json::{Value, json};
use std::cell::{Cell, RefCell};
use std::fs;

fn exported(client: &Client, id: &str) -> SessionPlays {
    client.get(&format!("/v1/sessions/{id}/plays")).unwrap()
}

#[test]
fn an_export_has_one_row_per_play() {
    let daemon = Bench::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events();
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
    let text = table(&exported(&client, &started.id)).unwrap();
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head = table.headers().unwrap().clone();
    let rows: Vec<_> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), receipts.len(), "{text}");
    for (row, receipt) in rows.iter().zip(&receipts) {
        let (onset, bursts) = (receipt.onset.unwrap(), receipt.counts.bursts.unwrap());
        let label = receipt.order.terms.labels.get("condition").map(|label| format!("condition={label}"));
        for (column, value) in [
            ("session", started.id.clone()),
            ("participant", "P07".into()),
            ("seed", "7".into()),
            ("session_labels", "block=2".into()),
            ("play", receipt.id.to_string()),
            ("trial", receipt.order.terms.trial.map_or_else(String::new, |trial| trial.to_string())),
            ("labels", label.unwrap_or_default()),
            ("pattern_sha256", receipt.sha256.clone()),
            ("onset_tick", onset.actual_tick.to_string()),
            ("onset_monotonic_ns", onset.monotonic_ns.to_string()),
            ("bursts_planned", bursts.planned.to_string()),
            ("bursts_played", bursts.played.to_string()),
            ("state", receipt.state.name().into()),
            ("cause", receipt.cause.as_ref().map_or_else(String::new, ToString::to_string)),
        ] {
            let place = head.iter().position(|name| name == column).unwrap();
            assert_eq!(row[place], value, "{column}");
        }
    }
    // The line of a play's end is lost: the export keeps the play and names the damage.
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let day = daemon.session(&started.id);
    let is_end = |line: &str| line.contains("\"event\":\"ended\"") && line.contains("\"id\":2,");
    let text = fs::read_to_string(&day).unwrap();
    let damaged = text.split_inclusive('\n').map(|line| if is_end(line) { "{\"tor\n" } else { line });
    fs::write(&day, damaged.collect::<String>()).unwrap();
    let exported = exported(&client, &started.id);
    assert!(!exported.complete && exported.missing[0].contains("1 of 3 plays are missing"), "{exported:?}");
    let states: Vec<_> =
        exported.plays.iter().map(|play| (play.receipt.id, play.receipt.state.name())).collect();
    assert_eq!(states, [(1, "done"), (3, "stopped"), (2, "unknown")]);
    let is_line =
        |problem: &String| problem.contains(".jsonl:") && problem.contains("not a line of a session");
    assert!(exported.problems.iter().any(is_line), "{:?}", exported.problems);
}

#[test]
fn answers_of_the_participant_stand_in_the_rows_of_their_plays() {
    let daemon = Bench::start();
    let (mut client, started) = owner(&daemon, "P07", true);
    let mut events = client.events();
    let item = json!({"pattern": "pin-60", "seconds": 0.05, "gap_ms": 10});
    for (path, play) in [
        ("/v1/play", json!({"pattern": "pin-60", "seconds": 0.1})),
        ("/v1/play", json!({"items": [item, item]})),
    ] {
        let _: Value = client.post(path, &play).unwrap();
        ended(&mut events);
    }
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    assert_eq!(began(&mut events), 3);
    let response = format!("\ta\r\nb\0{}", "x".repeat(2000));
    let whole = json!({"response": response, "correct": true, "rt_ms": 512.5, "level": -0.4, "factors": {"b": "2", "a": "1"}});
    assert_eq!(client.post::<Value>("/v1/plays/1/answer", &whole).unwrap(), json!({}));
    let _: Value = client.post("/v1/plays/2/answer", &json!({"response": "2", "correct": null})).unwrap();
    let refused = |client: &Client, play: &str, answer: &Value| {
        problem(client.post(&format!("/v1/plays/{play}/answer"), answer)).code
    };
    assert_eq!(refused(&client, "1", &whole), "exists");
    assert_eq!(refused(&client, "3", &json!({"response": "x".repeat(8192)})), "bad-request");
    assert_eq!(refused(&client, "77", &whole), "not-found");
    assert_eq!(refused(&client, "last", &whole), "bad-request");
    // Only the owner of an exclusive session.
    assert_eq!(refused(&daemon.client(), "3", &whole), "session-exclusive");
    let wrong =
        json!({"response": "-3", "correct": false, "rt_ms": 20.5, "level": -1.5, "factors": {"c": "2"}});
    let _: Value = client.post("/v1/plays/3/answer", &wrong).unwrap();
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    client.set_token(None);
    assert_eq!(refused(&client, "3", &whole), "session-running");
    let exported = exported(&client, &started.id);
    let text = table(&exported).unwrap();
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head: Vec<_> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let answer = ["response", "correct", "response_time", "level", "factor_a", "factor_b", "factor_c"];
    let places = answer.map(|name| head.iter().position(|column| column == name).unwrap());
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
            ["-3", "false", "0.0205", "-1.5", "", "", "2"]
        ]
    );
    assert_eq!(serde_json::to_value(&exported.plays[0].answer).unwrap(), whole);
}

#[test]
fn an_export_has_a_row_for_each_item_of_a_sequence() {
    let daemon = Bench::start();
    let (client, started) = owner(&daemon, "P07", false);
    let mut events = client.events();
    let item = json!({"pattern": "pin-60", "seconds": 0.02, "gap_ms": 10, "scale": 0.5, "trigger": {"code": 9, "width_ms": 1}});
    let items = vec![item; 40];
    let sequence = json!({"items": items, "trial": 4, "labels": {"block": "1"}, "name": "taps"});
    let _: Value = client.post("/v1/play", &sequence).unwrap();
    let told = RefCell::new(Vec::new());
    let receipt = next_ended(&mut events, |event| {
        if let Event::Items { items, session, .. } = event {
            let mut told = told.borrow_mut();
            assert_eq!((items[0].item, session.as_deref()), (told.len() as u64, Some(&*started.id)));
            told.extend(items);
        }
    });
    let whole: Receipt = client.get(&format!("/v1/plays/{}", receipt.id)).unwrap();
    let records = whole.items.clone().unwrap();
    assert_eq!(told.into_inner(), *records);
    // For a stopped sequence, the export has the items that began.
    let _: Value = client.post("/v1/play", &sequence).unwrap();
    began(&mut events);
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    let begun = Cell::new(0);
    next_ended(&mut events, |event| {
        if let Event::Items { items, .. } = event {
            begun.set(begun.get() + items.len());
        }
    });
    let begun = begun.get();
    assert!(begun < 40);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let exported = exported(&client, &started.id);
    let text = table(&exported).unwrap();
    let mut table = csv::Reader::from_reader(text.as_bytes());
    let head = table.headers().unwrap().clone();
    let rows: Vec<_> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 40 + begun.max(1), "{text}");
    for (number, (row, record)) in rows.iter().zip(records.iter()).enumerate() {
        let of = |row: &csv::StringRecord, name: &str| {
            row[head.iter().position(|column| column == name).unwrap()].to_owned()
        };
        let tick = record.onset.unwrap().tick.to_string();
        for (column, value) in [
            ("item", &*number.to_string()),
            ("pattern", "pin-60"),
            ("trial", "4"),
            ("onset_tick", &tick),
            ("trigger_tick", &tick),
            ("trigger_code", "9"),
            ("offset_tick", &record.offset.unwrap().tick.to_string()),
            ("state", "played"),
            ("scale", "0.5"),
            ("ordered_ms", "20"),
            ("labels", "block=1"),
        ] {
            assert_eq!(of(row, column), value, "{column}");
        }
        let [first, wall] = [&rows[0], row].map(|row| of(row, "onset_wall_ns").parse::<i64>().unwrap());
        assert!((wall - first - 30_000_000 * number as i64).abs() < 1_000_000);
    }
    let play = &exported.plays[0];
    assert_eq!((play.receipt.items.as_ref().unwrap().len(), &*play.receipt.name), (40, "taps"));
    // The boot from the mock's handshake.
    assert!(play.receipt.device.boot.is_some() && play.patterns_kept);
}

/// The next receipt; `see` gets the events before it.
fn next_ended(events: &mut Events, see: impl Fn(Event)) -> Receipt {
    next(events, |event| match event {
        Event::Ended { receipt } => Some(*receipt),
        event => {
            see(event);
            None
        }
    })
}
