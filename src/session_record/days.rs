//! The daily files: their names, and the repair of a torn last line.
//!
//! A line is anything that ends with a newline.

use jiff::civil::Date;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

/// Bytes read at a time.
const PIECE: u64 = 1 << 16;

/// The file of a day.
pub(super) fn name(day: Date) -> String {
    format!("{day}.jsonl")
}

/// The day of a file, if the file's name is exactly that of the day.
pub(super) fn day(file: &str) -> Option<Date> {
    let day: Date = file.strip_suffix(".jsonl")?.parse().ok()?;
    (name(day) == file).then_some(day)
}

/// The whole lines within the last `most` bytes of a file; the first of them may be torn.
pub(super) fn last_lines(file: &File, most: u64) -> io::Result<Vec<u8>> {
    let length = file.metadata()?.len();
    let start = length.saturating_sub(most);
    let mut bytes = vec![0; usize::try_from(length - start).map_err(io::Error::other)?];
    file.read_exact_at(&mut bytes, start)?;
    let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    bytes.truncate(whole);
    Ok(bytes)
}

/// Cuts off the bytes after the last newline. Returns the new length and the number of bytes cut.
pub(super) fn cut_torn(file: &File) -> io::Result<(u64, u64)> {
    let length = file.metadata()?.len();
    let mut end = length;
    let mut piece = Vec::new();
    while end > 0 {
        let start = end.saturating_sub(PIECE);
        piece.resize(usize::try_from(end - start).map_err(io::Error::other)?, 0);
        file.read_exact_at(&mut piece, start)?;
        if let Some(at) = piece.iter().rposition(|&byte| byte == b'\n') {
            end = start + at as u64 + 1;
            break;
        }
        end = start;
    }
    if end < length {
        file.set_len(end)?;
    }
    Ok((end, length - end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_the_last_newline_is_cut() {
        for (text, keeps) in [
            (String::new(), 0),
            ("{}\n".to_owned(), 3),
            ("{}\n{\"ti".to_owned(), 3),
            ("{\"ti".to_owned(), 0),
            (format!("{{}}\n{}", "x".repeat(200_000)), 3),
            ("x".repeat(65_536), 0),
            (format!("{}\n", "x".repeat(65_535)), 65_536),
        ] {
            let mut file = tempfile::tempfile().unwrap();
            io::Write::write_all(&mut file, text.as_bytes()).unwrap();
            assert_eq!(cut_torn(&file).unwrap(), (keeps, text.len() as u64 - keeps));
            assert_eq!(file.metadata().unwrap().len(), keeps);
        }
    }
}
