//! `meissner-uf2 ELF UF2`: makes the file to copy onto a Pico, and prints the size of the firmware.
//!
//! The format is Microsoft's UF2: blocks of 512 bytes, each with 256 bytes of flash and their address.

#![forbid(unsafe_code)]

use anyhow::{Context, Result, ensure};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader, SectionHeader};
use object::{Endianness, elf};
use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs;

const FLASH: std::ops::Range<u32> = 0x1000_0000..0x1020_0000;
/// Banks 0 to 3, as `memory.x` divides them.
const RAM: std::ops::Range<u32> = 0x2000_0000..0x2004_0000;
const STACK: u32 = 32 << 10;
/// The payload of a block: a page of flash.
const PAGE: usize = 256;
/// What the flash erases at once.
const SECTOR: u32 = 4096;
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
    fill(&mut pages);
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

/// Adds pages of zeros until each sector but the last is whole.
///
/// The chip's boot ROM erases a sector before the first of each 16 *block numbers*, and takes the sector from that block's address
/// (erratum RP2040-E14). Sixteen numbers are one sector only if no page is left out. Otherwise the ROM erases pages that it has just
/// written.
fn fill(pages: &mut BTreeMap<u32, [u8; PAGE]>) {
    let Some((&last, _)) = pages.last_key_value() else { return };
    let sectors: BTreeSet<u32> = pages.keys().map(|page| page - page % SECTOR).collect();
    for page in sectors.into_iter().flat_map(|sector| (sector..sector + SECTOR).step_by(PAGE)) {
        if page < last {
            pages.entry(page).or_insert([0; PAGE]);
        }
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

    /// The boot ROM's virtual disk as it treats flash, after its source (raspberrypi/pico-bootrom-rp2040, `virtual_disk.c`).
    struct Rom {
        flash: Vec<u8>,
        taken: BTreeSet<u32>,
        /// By block number, not by address.
        erased: BTreeSet<u32>,
    }

    impl Rom {
        /// The flash holds this byte everywhere: 0xff when it is erased.
        fn new(byte: u8) -> Self {
            let flash = vec![byte; (FLASH.end - FLASH.start) as usize];
            Self { flash, taken: BTreeSet::new(), erased: BTreeSet::new() }
        }

        /// Takes a block; returns whether the transfer is complete, which restarts the chip.
        fn take(&mut self, block: &[u8]) -> bool {
            let word = |at: usize| u32::from_le_bytes(block[at..at + 4].try_into().unwrap());
            let [address, number, count] = [12, 20, 24].map(word);
            assert!(FLASH.contains(&address) && number < count);
            if self.taken.insert(number) {
                if self.erased.insert(number * PAGE as u32 / SECTOR) {
                    let sector = (address - address % SECTOR - FLASH.start) as usize;
                    self.flash[sector..sector + SECTOR as usize].fill(0xff);
                }
                // Flash is programmed from ones to zeros only.
                let page = (address - FLASH.start) as usize;
                for (at, new) in self.flash[page..page + PAGE].iter_mut().zip(&block[32..]) {
                    *at &= new;
                }
            }
            self.taken.len() == count as usize
        }
    }

    /// Segments like the firmware's, with holes that end anywhere.
    fn images() -> impl Iterator<Item = BTreeMap<u32, [u8; PAGE]>> {
        let sizes = [1, 255, 256, 3_000, 4_096, 5_888, 71_424];
        let holes = [0, 1, 256, 4_095, 4_096, 59_648];
        sizes.into_iter().flat_map(move |size| holes.map(move |hole| (size, hole))).map(|(size, hole)| {
            let mut pages = BTreeMap::new();
            let data = |salt: usize| (0..size).map(|at| (at * 31 + salt) as u8).collect::<Vec<_>>();
            put(&mut pages, FLASH.start, &data(1));
            put(&mut pages, FLASH.start + (size + hole) as u32, &data(2));
            put(&mut pages, FLASH.start + (3 * size + 2 * hole) as u32, &data(3));
            pages
        })
    }

    /// The image on a flash that takes the blocks in this order.
    fn written(out: &[u8], used: u8, order: impl Iterator<Item = usize>) -> Vec<u8> {
        let mut rom = Rom::new(used);
        let complete = order.map(|block| rom.take(&out[block * 512..][..512])).last();
        assert_eq!(complete, Some(true));
        rom.flash
    }

    #[test]
    fn the_boot_rom_writes_the_image_in_any_order_on_any_flash() {
        let mut broken = 0;
        for pages in images() {
            let filled = {
                let mut pages = pages.clone();
                fill(&mut pages);
                pages
            };
            let is_whole = |flash: Vec<u8>| {
                pages
                    .iter()
                    .all(|(address, page)| flash[(address - FLASH.start) as usize..].starts_with(page))
            };
            for used in [0xff, 0x00, 0xa5] {
                for out in [blocks(&filled), blocks(&pages)] {
                    let count = out.len() / 512;
                    // A step that shares no factor with the count visits each block once.
                    let step =
                        (7..).find(|step| (2..=*step).all(|by| step % by > 0 || count % by > 0)).unwrap();
                    let whole = [
                        is_whole(written(&out, used, 0..count)),
                        is_whole(written(&out, used, (0..count).rev())),
                        is_whole(written(&out, used, (0..count).map(|at| at * step % count))),
                        // A host that writes a block twice.
                        is_whole(written(&out, used, (0..count).flat_map(|at| [at, at / 2]))),
                    ];
                    if count == filled.len() {
                        assert_eq!(whole, [true; 4]);
                    } else {
                        broken += u32::from(whole.contains(&false));
                    }
                }
            }
        }
        assert!(broken > 0, "the model knows the erratum");
    }
}
