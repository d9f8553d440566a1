//! Network management (CiA 301, 7.2.8): commands to a node, and what its heartbeat says.

use super::{Frame, cob};

/// What the master may ask of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtCommand {
    /// Go to operational: PDOs are exchanged.
    Start = 0x01,
    /// Go to stopped.
    Stop = 0x02,
    /// Go to pre-operational: SDO only.
    EnterPreOperational = 0x80,
    /// Reset the node.
    ResetNode = 0x81,
    /// Reset its communication only.
    ResetCommunication = 0x82,
}

impl NmtCommand {
    /// The frame for one node.
    pub fn frame(self, node: u8) -> Frame {
        Frame::new(cob::NMT, &[self as u8, node])
    }

    /// The command in a frame, if it is for `node` (or for all).
    pub fn from_frame(frame: &Frame, node: u8) -> Option<Self> {
        let (cob::NMT, &[command, address]) = (frame.id, frame.data()) else { return None };
        if address != 0 && address != node {
            return None;
        }
        [Self::Start, Self::Stop, Self::EnterPreOperational, Self::ResetNode, Self::ResetCommunication]
            .into_iter()
            .find(|known| *known as u8 == command)
    }
}

/// State of a node as its heartbeat tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum NodeState {
    /// Just started.
    #[default]
    BootUp = 0x00,
    /// No communication but NMT and heartbeat.
    Stopped = 0x04,
    /// PDOs are exchanged.
    Operational = 0x05,
    /// SDO only.
    PreOperational = 0x7F,
}

impl NodeState {
    /// The heartbeat frame of a node in this state.
    pub fn frame(self, node: u8) -> Frame {
        Frame::new(cob::heartbeat(node), &[self as u8])
    }

    /// The state in a heartbeat of `node`. The toggle bit of node guarding is ignored.
    pub fn from_frame(frame: &Frame, node: u8) -> Option<Self> {
        let &[state] = frame.data() else { return None };
        if frame.id != cob::heartbeat(node) {
            return None;
        }
        [Self::BootUp, Self::Stopped, Self::Operational, Self::PreOperational]
            .into_iter()
            .find(|known| *known as u8 == state & 0x7F)
    }
}

/// The SYNC frame, without counter.
pub fn sync() -> Frame {
    Frame::new(cob::SYNC, &[])
}
