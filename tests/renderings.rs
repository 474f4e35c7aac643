//! Renderings of objects over the API, and previews of patterns: what they answer, what is refused, and the end of their processes.

use crate::harness::{
    Daemon, TIMEOUT, document, ended, meissner, next, printed, problem, refusal, wait_until,
};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use meissner_api::{Event, PatternPreview, RenderMethod, Rendered, Rendering, RenderingState, Status};
use meissner_array::pattern::Pattern;
use meissner_client::{Client, Events};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use sha2::Digest;
use std::fs;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;

/// The next event of a rendering: how it stands, and whether its pattern can be played.
fn event(events: &mut Events) -> (RenderingState, bool) {
    next(events, |event| match event {
        Event::Rendering { state, found, .. } => Some((state, found)),
        _ => None,
    })
}

/// Waits until a rendering has failed; returns why.
fn failed(events: &mut Events) -> String {
    next(events, |event| match event {
        Event::Rendering { state: RenderingState::Failed, problem, found: false, .. } => problem,
        _ => None,
    })
}

/// Renders an object and waits until it is judged.
fn rendered(client: &mut Client, request: &Value) -> Rendered {
    let mut events = client.events().unwrap();
    let begun: Rendering = client.post_within(TIMEOUT, "/v1/renderings", request).unwrap();
    assert_eq!((begun.state, begun.found, begun.rendered), (RenderingState::Running, false, None));
    // First the pattern can be played, then it is judged.
    assert_eq!(event(&mut events), (RenderingState::Running, false));
    assert_eq!(event(&mut events), (RenderingState::Running, true));
    assert_eq!(event(&mut events), (RenderingState::Done, true));
    let rendering: Rendering = client.get_within(TIMEOUT, &format!("/v1/renderings/{}", begun.id)).unwrap();
    let method: RenderMethod =
        serde_json::from_value(request["method"].clone()).unwrap_or(RenderMethod::Auto);
    assert_eq!((rendering.found, rendering.method), (true, method));
    *rendering.rendered.unwrap()
}

fn bar(name: &str) -> Value {
    json!({
        "kind": "object", "name": name, "shape": "bar", "length_mm": 12, "width_mm": 0.8, "angle_deg": 30,
        "touch": {"press": {"depth_um": 500, "hold_s": 0.1}}
    })
}

/// An NPY file of heights, um, in base64.
fn npy([rows, columns]: [usize; 2], um: impl Fn(usize, usize) -> f32) -> String {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}\n");
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    let mut bytes = [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes()].concat();
    for row in 0..rows {
        bytes.extend((0..columns).flat_map(|column| um(row, column).to_le_bytes()));
    }
    STANDARD.encode(bytes)
}

/// An object whose touch lasts half a minute: it is rendered and judged for long.
pub(crate) fn long_touch() -> Value {
    let mut object = bar("long");
    object["touch"] = json!({"press": {"depth_um": 500, "hold_s": 29}});
    object
}

fn long() -> Value {
    json!({"object": long_touch(), "method": "rule"})
}

/// The processes that a daemon has started and that have not ended.
fn children(daemon: &Daemon) -> Vec<i32> {
    let status: Status = daemon.client().get("/v1/status").unwrap();
    let threads = fs::read_dir(format!("/proc/{}/task", status.daemon.pid)).unwrap();
    let of =
        |thread: std::io::Result<fs::DirEntry>| fs::read_to_string(thread.unwrap().path().join("children"));
    let all: String = threads.filter_map(|thread| of(thread).ok()).collect();
    all.split_whitespace().map(|pid| pid.parse().unwrap()).filter(|&pid| runs(pid)).collect()
}

/// The fields of a process's `stat` from its state on; none if it has ended.
fn stat(pid: i32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<_> = stat.rsplit_once(')')?.1.split_whitespace().map(str::to_owned).collect();
    (fields[0] != "Z" && fields[0] != "X").then_some(fields)
}

fn runs(pid: i32) -> bool {
    stat(pid).is_some()
}

fn map(name: &str, file: &str) -> Value {
    json!({
        "kind": "object", "name": name, "shape": "heightmap", "file": file, "mm_per_pixel": 0.4,
        "touch": {"press": {"depth_um": 500, "hold_s": 0.1}}
    })
}

fn a_shipped_object_is_rendered_and_judged_as_by_the_commands_and_plays(daemon: &Daemon) {
    let mut client = daemon.armed();
    let found = rendered(&mut client, &json!({"object": "edge-45"}));
    let command = printed(meissner().args(["render", "edge-45"]));
    assert_eq!(found.pattern.trim_end(), command.trim_end());
    let told = document(meissner().args(["render", "edge-45", "--json"]));
    assert_eq!(json!([found.duration_s, found.highest_um]), json!([told["duration_s"], told["highest_um"]]));
    let judged = document(meissner().args(["judge", "--object", "edge-45", "--fingers", "1", "--json"]));
    for (name, of_command) in
        [("auto", "render auto"), ("rule", "render rule"), ("vibrate-60", "within reach at 60 Hz")]
    {
        let found = found.judged.iter().find(|line| line.name == name).unwrap();
        let lines = judged["lines"].as_array().unwrap();
        let told = lines.iter().find(|line| line["name"] == of_command).unwrap();
        for key in ["r", "error", "r_by_class", "error_by_class", "spikes"] {
            assert_eq!(serde_json::to_value(found).unwrap()[key], told[key], "{name}: {key}");
        }
    }
    let of = &found.response;
    for trains in [&of.real_s, &of.found_s, &of.rule_s] {
        assert_eq!((trains.len(), of.places_mm.len(), of.class.len()), (566, 566, 566));
        assert!(trains.iter().flatten().count() > 100);
        assert!(trains.iter().flatten().all(|at_s| (0.0..=of.seconds).contains(at_s)));
    }
    // It plays without being stored, and a preview shows the finger that has judged it.
    let mut events = client.events().unwrap();
    let _: Value = client
        .post_within(TIMEOUT, "/v1/play", &json!({"pattern": "rendering:1", "pattern_sha256": found.sha256}))
        .unwrap();
    assert_eq!(ended(&mut events).name, "edge-45");
    let preview: PatternPreview =
        client.get_within(TIMEOUT, "/v1/patterns/rendering:1/preview?seconds=0.3").unwrap();
    let early = |trains: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let of = |train: &Vec<f64>| train.iter().copied().filter(|at_s| *at_s < 0.3).collect();
        trains.iter().map(of).collect()
    };
    assert_eq!(preview.sha256, found.sha256);
    assert_eq!(early(&preview.spikes.times_s), early(&of.found_s));
}

fn a_height_map_comes_with_its_file(daemon: &Daemon) {
    let mut client = daemon.client();
    let heights = npy([30, 30], |_, column| if (14..16).contains(&column) { 0.0 } else { -2000.0 });
    let request =
        json!({"object": map("ridge", "ridge.npy"), "files": {"ridge.npy": heights}, "method": "field"});
    let found = rendered(&mut client, &request);
    // The file is not in the pattern, so the pattern only names the object.
    let pattern = Pattern::parse(&found.pattern, "found").unwrap();
    assert_eq!(pattern.provenance()["object"].as_str(), Some("ridge"));
    let mut ridge = bar("drawn");
    ridge["angle_deg"] = json!(90);
    let bar = rendered(&mut client, &json!({"object": ridge, "method": "field"}));
    assert_eq!((&bar.object, bar.judged[0].name.as_str()), (&ridge, "field"));
    let near = (found.highest_um - bar.highest_um).abs();
    assert!(near < 0.1 * bar.highest_um, "{} {}", found.highest_um, bar.highest_um);
    // The session record keeps the hash of the file, not the file.
    let record = || -> String {
        let days = fs::read_dir(daemon.path("state/meissner/logbook")).unwrap();
        days.filter_map(|day| fs::read_to_string(day.unwrap().path()).ok()).collect()
    };
    let hash = request["files"]["ridge.npy"].as_str().map(|text| STANDARD.decode(text).unwrap());
    let hash = format!("{:x}", sha2::Sha256::digest(hash.unwrap()));
    wait_until(|| record().contains(&format!("{{\"ridge.npy\":\"{hash}\"}}")));
}

fn what_is_no_object_is_refused_in_one_line(daemon: &Daemon) {
    let mut client = daemon.client();
    let unknown = problem(client.post_within(TIMEOUT, "/v1/renderings", &json!({"object": "egde-45"})));
    assert_eq!((&*unknown.code, unknown.status), ("not-found", 404));
    assert!(unknown.detail.contains("`egde-45`: did you mean `edge-45`?"), "{unknown}");
    let changed = |key: &str, value: Value| {
        let mut object = bar("drawn");
        object[key] = value;
        json!({"object": object})
    };
    for (request, says) in [
        (changed("lenght_mm", json!(1)), "unknown key `lenght_mm`: did you mean `length_mm`?"),
        (changed("name", json!("../x")), "`name` is `../x`: must be 1 to 64 of a-z, 0-9 and -"),
        (json!({"object": map("m", "m.npy")}), "`files` has no `m.npy`: add it in base64"),
        (json!({"object": map("m", "m.npy"), "files": {"m.npy": "*"}}), "`files.m.npy` is not base64"),
        (
            json!({"object": map("m", "../m.npy"), "files": {"../m.npy": ""}}),
            "`files` has `../m.npy`: must be the name of",
        ),
    ] {
        let refused = problem(client.post_within(TIMEOUT, "/v1/renderings", &request));
        assert_eq!((&*refused.code, refused.status), ("bad-request", 400), "{refused}");
        assert!(refused.detail.contains(says), "{refused}");
    }
    let large = json!({"object": map("m", "m.npy"), "files": {"m.npy": "A".repeat(4 << 20)}});
    assert_eq!(refusal(client.post_within(TIMEOUT, "/v1/renderings", &large)), ("too-large".into(), 413));
    // What only the process finds out.
    let mut events = client.events().unwrap();
    for (request, says) in [
        (json!({"object": map("m", "m.png"), "files": {"m.png": "AAAA"}}), "`file` is not a PNG file"),
        (changed("center_mm", json!([50, 50])), "drawn: the object never lies under the finger"),
        (
            changed("touch", json!({"press": {"depth_um": 500, "hold_s": 40}})),
            " s: at most 30 s are rendered, shorten it",
        ),
    ] {
        let _: Rendering = client.post_within(TIMEOUT, "/v1/renderings", &request).unwrap();
        let problem = failed(&mut events);
        assert!(problem.contains(says) && !problem.contains('\n'), "{problem}");
    }
}

/// Judging a long touch takes a while: its pattern is there before, and stays when the rendering is cancelled.
fn a_pattern_that_was_found_stays_when_its_rendering_is_cancelled(daemon: &Daemon) {
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let begun: Rendering = client.post_within(TIMEOUT, "/v1/renderings", &long()).unwrap();
    let id = begun.id;
    assert_eq!(event(&mut events), (RenderingState::Running, false));
    assert_eq!(event(&mut events), (RenderingState::Running, true));
    let [process] = children(daemon)[..] else { panic!("{:?}", children(daemon)) };
    // It can end now only if it is killed.
    kill_process(Pid::from_raw(process).unwrap(), Signal::STOP).unwrap();
    let played: Value = client
        .post_within(TIMEOUT, "/v1/play", &json!({"pattern": format!("rendering:{id}"), "seconds": 0.2}))
        .unwrap();
    let cancelled: Rendering = client.delete(&format!("/v1/renderings/{id}")).unwrap();
    assert_eq!(
        (cancelled.state, cancelled.found, cancelled.rendered),
        (RenderingState::Cancelled, true, None)
    );
    assert_eq!(event(&mut events), (RenderingState::Cancelled, true));
    let shown: Value = client.get_within(TIMEOUT, &format!("/v1/patterns/rendering:{id}")).unwrap();
    assert_eq!(shown["pattern"]["name"], "long");
    wait_until(|| children(daemon).is_empty());
    // The next case arms.
    let _: Value = client.get_within(TIMEOUT, &format!("/v1/plays/{}?wait=10", played["id"])).unwrap();
}

fn one_rendering_runs_at_a_time_in_a_bounded_process_and_an_e_stop_does_not_end_it(daemon: &Daemon) {
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let begun: Rendering = client.post_within(TIMEOUT, "/v1/renderings", &long()).unwrap();
    assert_eq!(&*begun.object, "long");
    assert_eq!(event(&mut events), (RenderingState::Running, false));
    assert_eq!(event(&mut events), (RenderingState::Running, true));
    let [process] = children(daemon)[..] else { panic!("{:?}", children(daemon)) };
    kill_process(Pid::from_raw(process).unwrap(), Signal::STOP).unwrap();
    let busy = problem(client.post_within(TIMEOUT, "/v1/renderings", &long()));
    assert_eq!((&*busy.code, busy.status), ("rendering-running", 409));
    assert!(busy.detail.contains(&format!("rendering {} of `long` runs", begun.id)), "{busy}");
    // The process has low priority, bounded memory that is not locked, and none of the daemon's files.
    assert!(stat(process).unwrap()[16].parse::<i32>().unwrap() >= 10);
    let limits = fs::read_to_string(format!("/proc/{process}/limits")).unwrap();
    let data = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
    assert!(data.contains(&meissner::render_process::MEMORY.to_string()), "{data}");
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    assert!(status.lines().any(|line| line.split_whitespace().eq(["VmLck:", "0", "kB"])), "{status}");
    let files: Vec<_> =
        fs::read_dir(format!("/proc/{process}/fd")).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(files, ["0", "1", "2"]);
    let _: Value = client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 60})).unwrap();
    let stopped: Status = client.post("/v1/estop", &json!({})).unwrap();
    assert_eq!((&*stopped.state, &*stopped.cause), ("faulted", "estop"));
    let shown: Rendering = client.get("/v1/renderings/last").unwrap();
    assert_eq!(shown.state, RenderingState::Running);
    kill_process(Pid::from_raw(process).unwrap(), Signal::KILL).unwrap();
    let problem = next(&mut events, |event| match event {
        Event::Rendering { state: RenderingState::Failed, problem, found: true, .. } => problem,
        _ => None,
    });
    assert!(problem.contains("ended without a result") && problem.contains("256 MiB"), "{problem}");
    // The place is free again.
    rendered(&mut client, &json!({"object": "dot", "method": "field"}));
}

#[test]
fn a_rendering_ends_with_its_daemon() {
    for signal in [Signal::TERM, Signal::KILL] {
        let mut daemon = Daemon::start();
        let mut client = daemon.client();
        let mut events = client.events().unwrap();
        let _: Rendering = client.post_within(TIMEOUT, "/v1/renderings", &long()).unwrap();
        while event(&mut events) != (RenderingState::Running, true) {}
        let process = children(&daemon)[0];
        daemon.signal(signal);
        daemon.wait();
        wait_until(|| !runs(process));
    }
}

fn a_preview_shows_pins_and_spikes_of_any_pattern(daemon: &Daemon) {
    let mut client = daemon.client();
    let preview: PatternPreview =
        client.get_within(TIMEOUT, "/v1/patterns/edge-45/preview?from_s=0.1&seconds=0.25").unwrap();
    let asked = ["displacement", "edge-45", "--seconds", "2", "--json"];
    let of_command = document(meissner().args(asked));
    let motors: Vec<usize> = serde_json::from_value(of_command["motors"].clone()).unwrap();
    assert_eq!((preview.heights_um.len(), preview.from_s, preview.seconds), (24, 0.1, 0.25));
    for (motor, heights_um) in preview.heights_um.iter().enumerate() {
        let column = motors.iter().position(|moves| *moves == motor);
        let told = |sample: usize| {
            column.map_or(0.0, |column| of_command["displacement_um"][100 + sample][column].as_f64().unwrap())
        };
        let is_near = |(sample, um): (usize, &f64)| (um - told(sample)).abs() < 0.16;
        assert!(heights_um.len() == 250 && heights_um.iter().enumerate().all(is_near), "motor {motor}");
    }
    let times = || preview.spikes.times_s.iter().flatten();
    assert!(times().count() > 100 && times().all(|at_s| (0.1..=0.35).contains(at_s)));
    for name in ["none", "rendering:99"] {
        let refused = refusal(client.get_within(TIMEOUT, &format!("/v1/patterns/{name}/preview")));
        assert_eq!(refused, ("not-found".into(), 404));
    }
    for query in ["seconds=3", "from_s=-1", "sconds=1", "seconds=NaN"] {
        let refused = problem(client.get_within(TIMEOUT, &format!("/v1/patterns/edge-45/preview?{query}")));
        assert!(refused.code == "bad-request" && refused.detail.contains(query), "{refused}");
    }
    assert!(children(daemon).is_empty());
}

fn the_ninth_preview_that_would_wait_is_refused_and_those_of_clients_that_hang_up_end(daemon: &Daemon) {
    const ASKED: usize = 20;
    const REQUEST: &[u8] =
        b"GET /v1/patterns/edge-45/preview?from_s=60&seconds=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
    let ask = || {
        let mut stream = UnixStream::connect(daemon.socket()).unwrap();
        stream.write_all(REQUEST).unwrap();
        stream
    };
    let first = ask();
    // A process that is stopped before it runs its program would keep the daemon's thread waiting in `spawn`.
    let begun = |pid: i32| {
        fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.starts_with(b"meissner-render"))
    };
    wait_until(|| children(daemon).first().is_some_and(|&pid| begun(pid)));
    let process = Pid::from_raw(children(daemon)[0]).unwrap();
    // It stands still, so eight may wait for it and no more; it can end now only if it is killed.
    kill_process(process, Signal::STOP).unwrap();
    let (sender, answers) = std::sync::mpsc::channel();
    let others: Vec<UnixStream> = (1..ASKED).map(|_| ask()).collect();
    for stream in &others {
        let (mut stream, sender) = (stream.try_clone().unwrap(), sender.clone());
        std::thread::spawn(move || {
            let mut answer = String::new();
            // A test that has ended reads no answer.
            let _ = stream.read_to_string(&mut answer).map(|_| sender.send(answer));
        });
    }
    for _ in 0..ASKED - 9 {
        let answer = answers.recv_timeout(TIMEOUT).unwrap();
        assert!(
            answer.starts_with("HTTP/1.1 503") && answer.contains("too many clients ask for previews"),
            "{answer}"
        );
    }
    assert!(answers.try_recv().is_err(), "eight wait");
    assert_eq!(children(daemon).len(), 1, "one is computed at a time");
    first.shutdown(Shutdown::Both).unwrap();
    others.iter().for_each(|stream| drop(stream.shutdown(Shutdown::Both)));
    wait_until(|| children(daemon).is_empty());
    // Its place is free again.
    let _: PatternPreview =
        daemon.client().get_within(TIMEOUT, "/v1/patterns/edge-45/preview?seconds=0.01").unwrap();
}

#[test]
fn renderings_and_previews_on_one_daemon() {
    let daemon = Daemon::start();
    assert_eq!(refusal(daemon.client().get("/v1/renderings/last")), ("not-found".into(), 404));
    a_shipped_object_is_rendered_and_judged_as_by_the_commands_and_plays(&daemon);
    a_pattern_that_was_found_stays_when_its_rendering_is_cancelled(&daemon);
    one_rendering_runs_at_a_time_in_a_bounded_process_and_an_e_stop_does_not_end_it(&daemon);
    a_preview_shows_pins_and_spikes_of_any_pattern(&daemon);
    the_ninth_preview_that_would_wait_is_refused_and_those_of_clients_that_hang_up_end(&daemon);
    what_is_no_object_is_refused_in_one_line(&daemon);
    a_height_map_comes_with_its_file(&daemon);
}
