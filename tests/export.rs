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
    daemon.wait_for_record();
    let folder = fs::read_dir(daemon.path("state/meissner/logbook")).unwrap();
    let mut files = folder.map(|file| file.unwrap().path());
    let day = files.find(|file| file.extension().is_some_and(|extension| extension == "jsonl")).unwrap();
    let is_end = |line: &str| line.contains("\"event\":\"ended\"") && line.contains("\"id\":2,");
    let text = fs::read_to_string(&day).unwrap();
    let damaged = text.split_inclusive('\n').map(|line| if is_end(line) { "{\"tor\n" } else { line });
    fs::write(&day, damaged.collect::<String>()).unwrap();
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(line.contains("1 of 3 plays are missing") && line.contains("--incomplete"), "{line}");
    let (exported, warning) = exported(&daemon, &started.id);
    let states: Vec<_> = exported["plays"]
        .as_array()
        .unwrap()
        .iter()
        .map(|play| (&play["receipt"]["id"], &play["receipt"]["state"]))
        .collect();
    assert_eq!(
        states,
        [(&json!(1), &json!("done")), (&json!(3), &json!("stopped")), (&json!(2), &json!("unknown"))]
    );
    assert!(warning.contains(".jsonl:") && warning.contains("not a line of JSON"), "{warning}");
}

#[test]
fn answers_of_the_participant_stand_in_the_rows_of_their_plays() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", true);
    let mut events = client.events().unwrap();
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
    let refused = |client: &mut Client, play: &str, answer: &Value| {
        problem(client.post(&format!("/v1/plays/{play}/answer"), answer)).code
    };
    assert_eq!(refused(&mut client, "1", &whole), "exists");
    assert_eq!(refused(&mut client, "3", &json!({"response": "x".repeat(8192)})), "bad-request");
    assert_eq!(refused(&mut client, "77", &whole), "not-found");
    assert_eq!(refused(&mut client, "last", &whole), "bad-request");
    // Only the owner of an exclusive session.
    assert_eq!(refused(&mut daemon.client(), "3", &whole), "session-exclusive");
    let answer = "answer 3 -3 --wrong --rt-ms 20.5 --level -1.5 --factor c=2";
    let mut command = daemon.meissner();
    command.env("MEISSNER_SESSION_TOKEN", &started.token);
    assert_eq!(printed(command.args(answer.split(' '))).trim(), "play 3: answer recorded");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    client.set_token(None);
    assert_eq!(refused(&mut client, "3", &whole), "session-running");
    let text = printed(daemon.meissner().args(["session", "export", &started.id]));
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
    let (exported, _) = exported(&daemon, &started.id);
    assert_eq!(exported["plays"][0]["answer"], whole);
}

#[test]
fn an_export_has_a_row_for_each_item_of_a_sequence() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let item = json!({"pattern": "pin-60", "seconds": 0.02, "gap_ms": 10, "scale": 0.5, "trigger": {"code": 9, "width_ms": 1}});
    let items = vec![item; 40];
    let sequence = json!({"items": items, "trial": 4, "labels": {"block": "1"}, "name": "taps"});
    let _: Value = client.post("/v1/play", &sequence).unwrap();
    let mut told = Vec::new();
    let receipt = next_ended(&mut events, |event| {
        if let Event::Items { items, session, .. } = event {
            assert_eq!((items[0].item, session.as_deref()), (told.len() as u64, Some(&*started.id)));
            told.extend(items);
        }
    });
    let whole: Receipt = client.get(&format!("/v1/plays/{}", receipt.id)).unwrap();
    let records = whole.items.clone().unwrap();
    assert_eq!(told, *records);
    // For a stopped sequence, the export has the items that began.
    let _: Value = client.post("/v1/play", &sequence).unwrap();
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
    let exported = document(daemon.meissner().args(["session", "export", &started.id, "--json"]));
    let play = &exported["plays"][0];
    let receipt = &play["receipt"];
    assert_eq!((receipt["items"].as_array().unwrap().len(), &receipt["name"]), (40, &json!("taps")));
    // The boot from the mock's handshake.
    assert!(receipt["device"]["boot"].is_u64() && play["patterns_kept"] == true);
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
