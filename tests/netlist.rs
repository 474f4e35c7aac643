//! The netlist `firmware/netlist.csv` must agree with the firmware's outputs, and with the limits' rails and driver chips.

use meissner_test_support::paper::{MOTORS, MOTORS_PER_CHIP, MOTORS_PER_RAIL};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// The Pico's pin of each GPIO, from its pinout: every fifth pin or so is ground.
const PINS: [(u8, u8); 26] = [
    (0, 1),
    (1, 2),
    (2, 4),
    (3, 5),
    (4, 6),
    (5, 7),
    (6, 9),
    (7, 10),
    (8, 11),
    (9, 12),
    (10, 14),
    (11, 15),
    (12, 16),
    (13, 17),
    (14, 19),
    (15, 20),
    (16, 21),
    (17, 22),
    (18, 24),
    (19, 25),
    (20, 26),
    (21, 27),
    (22, 29),
    (26, 31),
    (27, 32),
    (28, 34),
];

fn read(file: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap()
}

/// The numbers of a constant of `firmware/src/board.rs`.
fn constant(board: &str, name: &str) -> Vec<u8> {
    let (_, rest) = board.split_once(&format!("const {name}: ")).unwrap();
    let (_, value) = rest.split_once('=').unwrap();
    let (value, _) = value.split_once(';').unwrap();
    value.split(',').filter_map(|number| number.trim_matches(['[', ']', ' ', '\n']).parse().ok()).collect()
}

#[test]
fn the_netlist_is_that_of_the_firmware() {
    let board = read("firmware/src/board.rs");
    let lines = constant(&board, "LINES");
    let ([trigger], [enable]) = (&constant(&board, "TRIGGER")[..], &constant(&board, "ENABLE")[..]) else {
        panic!("one GPIO each");
    };
    assert_eq!(lines.len(), MOTORS);
    let pin = |gpio: u8| PINS.iter().find(|(of, _)| *of == gpio).map(|(_, pin)| *pin).unwrap();
    let (per_rail, chips) = (MOTORS_PER_RAIL / MOTORS_PER_CHIP, MOTORS / MOTORS_PER_CHIP);
    let mut expected = BTreeSet::new();
    for (motor, &gpio) in lines.iter().enumerate() {
        let (chip, channel) = (motor / MOTORS_PER_CHIP, ["A", "B"][motor % MOTORS_PER_CHIP]);
        let rail = motor / MOTORS_PER_RAIL;
        expected.insert(format!("{gpio},{},LINE_{motor},{chip},PWM{channel},{motor},{rail}", pin(gpio)));
        expected.insert(format!("{enable},{},ENABLE,{chip},SHDN{channel},{motor},{rail}", pin(*enable)));
    }
    for chip in 0..chips {
        let rail = chip / per_rail;
        expected.insert(format!(",,RAIL_{rail},{chip},VOUT,,{rail}"));
    }
    expected.insert(format!("{trigger},{},TRIGGER,,,,", pin(*trigger)));
    let netlist = read("firmware/netlist.csv");
    let mut rows = netlist.lines();
    assert_eq!(rows.next(), Some("gpio,pico_pin,net,lt3572,lt3572_pin,motor,supply"));
    assert_eq!(rows.clone().count(), expected.len(), "a row is there twice, or missing");
    let found: BTreeSet<String> = rows.map(str::to_owned).collect();
    assert_eq!(found, expected);
}
