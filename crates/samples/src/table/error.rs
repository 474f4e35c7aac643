//! Why the bytes of a file are no table.

/// What is wrong with a file, in one line without the file's name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum TableError {
    #[error("more than {most} bytes: cut the file")]
    TooLarge { most: usize },
    #[error("is damaged: it ends too early, or is no gzip file ({why})")]
    Packed { why: String },
    #[error("is {what}, not text: export the numbers as CSV")]
    NotText { what: &'static str },
    #[error("has no row of numbers below a header of up to {most} rows: export the numbers as CSV")]
    NoNumbers { most: usize },
    #[error("line {line}: a quotation mark is not closed: delete it, or export the file again")]
    Quote { line: u64 },
    #[error(
        "line {line}: a space stands before a quotation mark, which then does not count: delete the space"
    )]
    SpaceBeforeQuote { line: u64 },
    #[error(
        "line {line}: {text} has another decimal mark than the numbers above it: export without thousands separators"
    )]
    Marks { line: u64, text: String },
}
