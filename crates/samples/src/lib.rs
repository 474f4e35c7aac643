//! Reads tables of numbers as instruments and spreadsheets write them, for recordings of a laser.

pub mod table;
