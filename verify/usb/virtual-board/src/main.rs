//! A virtual USB board: the program's own controller and simulated array, served by USB/IP.
//!
//!     virtual-board [SERIAL]
//!
//! `usbip attach -r 127.0.0.1 -b 0-0-0` plugs it in, `usbip detach` unplugs it. USB powers the board: each plug is a power-up with a new
//! boot id. It serves one connection at a time.
//!
//! The `usbip` crate provides the protocol. Its server is not used: it answers a read at once with no bytes, and the kernel then
//! reads again without a pause. A board lets the host wait.

#![forbid(unsafe_code)]

mod board;
mod descriptors;

use board::{Board, Reply};
use std::io;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::tcp::OwnedReadHalf;
use tokio::net::{TcpListener, TcpStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use usbip::usbip_protocol::{UsbIpCommand, UsbIpResponse};

/// Where `usbip` looks for devices.
const LISTEN: (&str, u16) = ("127.0.0.1", 3240);
/// The default serial number.
const SERIAL: &str = "E6614C0001";
/// Most commands read ahead. Beyond that the host waits.
const AHEAD: usize = 64;

#[tokio::main(flavor = "current_thread")]
async fn main() -> io::Result<()> {
    let serial = std::env::args().nth(1).unwrap_or_else(|| SERIAL.to_owned());
    let listener = TcpListener::bind(LISTEN).await?;
    let mut term = signal(SignalKind::terminate())?;
    println!("board {serial}: to be plugged in at {}:{}", LISTEN.0, LISTEN.1);
    tokio::select! {
        result = accept(&listener, &serial) => result,
        _ = term.recv() => Ok(()),
    }
}

async fn accept(listener: &TcpListener, serial: &str) -> io::Result<()> {
    loop {
        let (stream, _) = listener.accept().await?;
        // Unplugged, or a client with another protocol: take the next connection.
        if let Err(error) = serve(stream, serial).await {
            eprintln!("board {serial}: {error}");
        }
    }
}

/// One connection: a request for the list of devices, or a host's whole session with the board.
async fn serve(stream: TcpStream, serial: &str) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let (reader, mut writer) = stream.into_split();
    let (sender, mut commands) = mpsc::channel(AHEAD);
    // Reading a command cannot be cancelled half-way, so it has a task of its own.
    let reading = tokio::spawn(read(reader, sender));
    let device = descriptors::exported();
    let mut board: Option<Board> = None;
    let mut replies = Vec::new();
    loop {
        let nap = board.as_ref().map_or(Duration::from_secs(3600), Board::nap);
        let mut next = tokio::select! {
            command = commands.recv() => match command {
                Some(command) => Some(command),
                None => break,
            },
            () = tokio::time::sleep(nap) => None,
        };
        while let Some(command) = next {
            match (command, &mut board) {
                (UsbIpCommand::OpReqDevlist { .. }, None) => {
                    let list = UsbIpResponse::op_rep_devlist(std::slice::from_ref(&device));
                    replies.push(list.to_bytes());
                }
                (UsbIpCommand::OpReqImport { busid, .. }, None) => {
                    let asked = busid.split(|&byte| byte == 0).next().unwrap_or_default();
                    if asked == device.bus_id.as_bytes() {
                        let new = Board::switched_on(serial)?;
                        println!("board {serial}: plugged in, boot {:08x}", new.boot());
                        board = Some(new);
                        replies.push(UsbIpResponse::op_rep_import_success(&device).to_bytes());
                    } else {
                        replies.push(UsbIpResponse::op_rep_import_fail().to_bytes());
                    }
                }
                (command, Some(board)) => board.take(command, &mut replies),
                (_, None) => return Err(io::ErrorKind::InvalidData.into()),
            }
            next = commands.try_recv().ok();
        }
        if let Some(board) = &mut board {
            board.run(&mut replies);
        }
        send(&mut writer, &mut replies).await?;
    }
    if board.is_some() {
        println!("board {serial}: unplugged");
    }
    match reading.await {
        Ok(Err(error)) if error.kind() != io::ErrorKind::UnexpectedEof => Err(error),
        _ => Ok(()),
    }
}

async fn read(mut reader: OwnedReadHalf, commands: mpsc::Sender<UsbIpCommand>) -> io::Result<()> {
    loop {
        let command = UsbIpCommand::read_from_socket(&mut reader).await?;
        if commands.send(command).await.is_err() {
            return Ok(());
        }
    }
}

async fn send(writer: &mut (impl AsyncWriteExt + Unpin), replies: &mut Vec<Reply>) -> io::Result<()> {
    if !replies.is_empty() {
        writer.write_all(&replies.concat()).await?;
        replies.clear();
    }
    Ok(())
}
