//! `meissner-uf2 ELF UF2`: makes the file to copy onto a Pico, and prints the size of the firmware.
//!
//! The format is Microsoft's UF2: blocks of 512 bytes, each with 256 bytes of flash and their address.

use anyhow::{Context, Result, ensure};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader, SectionHeader};
use object::{Endianness, elf};
use std::collections::BTreeMap;
use std::env;
use std::fs;

const FLASH: std::ops::Range<u32> = 0x1000_0000..0x1020_0000;
/// Banks 0 to 3, as `memory.x` divides them.
const RAM: std::ops::Range<u32> = 0x2000_0000..0x2004_0000;
const STACK: u32 = 32 << 10;
/// The payload of a block: a page of flash.
const PAGE: usize = 256;
/// The RP2040's number among UF2 families.
const FAMILY: u32 = 0xe48b_ff56;
/// Flag: the block names its family.
const FAMILY_GIVEN: u32 = 0x2000;

fn main() -> Result<()> {
    let [elf, uf2]: [String; 2] =
        env::args().skip(1).collect::<Vec<_>>().try_into().ok().context("usage: meissner-uf2 ELF UF2")?;
    let bytes = fs::read(&elf).with_context(|| format!("cannot read {elf}"))?;
    let file = ElfFile32::<Endianness>::parse(&*bytes).with_context(|| format!("{elf}: not a 32-bit ELF"))?;
    let endian = file.endian();

    let mut pages = BTreeMap::new();
    let mut flash = 0;
    for segment in file.elf_program_headers() {
        let data = segment.data(endian, &*bytes).ok().context("a segment beyond the file's end")?;
        if segment.p_type(endian) == elf::PT_LOAD && !data.is_empty() {
            let at = segment.p_paddr(endian);
            ensure!(FLASH.contains(&at), "{elf}: a segment at {at:#x}, which is not flash");
            flash += data.len();
            put(&mut pages, at, data);
        }
    }
    ensure!(pages.contains_key(&FLASH.start), "{elf}: no second boot stage at the start of the flash");
    let written = blocks(&pages);
    fs::write(&uf2, &written).with_context(|| format!("cannot write {uf2}"))?;

    let sections = file.elf_header().sections(endian, &*bytes).context("no sections")?;
    let in_ram = |section: &&elf::SectionHeader32<Endianness>| {
        section.sh_flags(endian) & elf::SHF_ALLOC != 0 && RAM.contains(&section.sh_addr(endian))
    };
    let ram: u32 = sections.iter().filter(in_ram).map(|section| section.sh_size(endian)).sum();
    let (all_flash, all_ram) = (FLASH.end - FLASH.start, RAM.end - RAM.start);
    println!("flash {flash} of {all_flash} bytes; RAM {ram} of {all_ram} bytes, and {STACK} for the stack");
    println!("{uf2}: {} bytes", written.len());
    Ok(())
}

/// Spreads a segment over pages. Bytes outside of all segments are zero.
fn put(pages: &mut BTreeMap<u32, [u8; PAGE]>, at: u32, data: &[u8]) {
    for (address, &byte) in (at..).zip(data) {
        let offset = address as usize % PAGE;
        pages.entry(address - offset as u32).or_insert([0; PAGE])[offset] = byte;
    }
}

fn blocks(pages: &BTreeMap<u32, [u8; PAGE]>) -> Vec<u8> {
    let mut out = Vec::new();
    for (number, (address, page)) in pages.iter().enumerate() {
        let (number, count) = (number as u32, pages.len() as u32);
        let head = [0x0a32_4655, 0x9e5d_5157, FAMILY_GIVEN, *address, PAGE as u32, number, count, FAMILY];
        out.extend(head.iter().flat_map(|word: &u32| word.to_le_bytes()));
        out.extend(page);
        out.resize(out.len() + 476 - PAGE, 0);
        out.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_512_bytes_with_its_page_and_its_place() {
        let mut pages = BTreeMap::new();
        put(&mut pages, 0x1000_00fe, &[1, 2, 3]);
        let out = blocks(&pages);
        assert_eq!(out.len(), 2 * 512);
        let word = |at: usize| u32::from_le_bytes(out[at..at + 4].try_into().unwrap());
        assert_eq!([word(0), word(4), word(508)], [0x0a32_4655, 0x9e5d_5157, 0x0ab1_6f30]);
        assert_eq!([word(12), word(16), word(20), word(24), word(28)], [0x1000_0000, 256, 0, 2, FAMILY]);
        assert_eq!(out[32..32 + 256].iter().position(|&byte| byte != 0), Some(0xfe));
        assert_eq!((word(512 + 12), out[512 + 32]), (0x1000_0100, 3));
    }
}
