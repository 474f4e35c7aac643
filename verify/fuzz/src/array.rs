//! Descriptions of arrays: each is read or refused in one line, and what is read gives a layout that says the same.
//!
//! The controller and the session trust a layout: they index their tables with its motors and divide by its times. So a
//! controller of it must start, and say hello.

use crate::input::{text, told};
use firmware_protocol::controller::{BLOCK, Controller, HORIZON, Identity};
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::message::{DeviceMessage, HostMessage};
use firmware_protocol::tick::Tick;
use meissner_array::spec::{ArraySpec, MAX_MOTORS};

/// See the module.
pub fn run(data: &[u8]) {
    text(data, |text| match ArraySpec::parse(text, "file") {
        Ok(array) => {
            let again = ArraySpec::parse(array.text(), "file").expect("the text of an array");
            assert_eq!(again, array);
            check_layout(&array);
            start(&array);
        }
        Err(error) => told(error),
    });
}

fn check_layout(array: &ArraySpec) {
    let (layout, motor) = (array.layout(), array.motor());
    assert!((1..=MAX_MOTORS).contains(&array.motors()));
    assert_eq!(
        (layout.motors(), layout.id().name.as_str(), layout.tick_hz()),
        (array.motors(), array.name(), array.rate().hz())
    );
    assert_eq!((layout.max_up_pulses(), layout.max_seek()), (motor.most_pulses, motor.seek_pulses));
    assert!(layout.max_seek() >= layout.whole_travel() && layout.id().duty_up < layout.id().duty_down);
    assert!(motor.pulses(motor.travel_um).round() <= f64::from(motor.most_pulses));
    assert_eq!(u32::from(layout.horizon()), HORIZON + layout.driver_lead());
    for (groups, largest) in
        [(array.rails(), layout.motors_per_rail()), (array.chips(), layout.motors_per_chip())]
    {
        assert_eq!(groups.largest(), usize::from(largest));
        assert_eq!(groups.members().iter().map(Vec::len).sum::<usize>(), array.motors());
    }
    for motor in array.numbers() {
        let (m, place) = (usize::from(motor), array.position_mm(motor));
        assert_eq!(
            (array.rails().of(motor), array.chips().of(motor)),
            (layout.rail(m).into(), layout.chip(m).into())
        );
        assert!(array.rails().members()[array.rails().of(motor)].contains(&motor));
        assert_eq!(array.nearest_to(place), (motor, 0.0), "no pin stands in another");
    }
}

fn start(array: &ArraySpec) {
    let mut device = Controller::new(Identity::default(), *array.layout());
    let mut out = [0; MAX_FRAME];
    let len = frame::encode(&HostMessage::Hello { session: 1 }, &mut out).expect("a short message");
    device.receive(Tick::BOOT, &out[..len]);
    let _ = device.render(BLOCK);
    let len = device.transmit(Tick::BOOT, &mut out);
    let mut decoder = Decoder::new();
    let body = decoder.next(&mut &out[..len]).expect("a frame");
    let Ok(DeviceMessage::Hello(hello)) = frame::read(body) else { panic!("no hello") };
    assert_eq!(&hello.array, array.layout().id());
}
