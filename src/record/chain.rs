//! The hash chain over the rows of a run: a link every [`LINK_ROWS`] rows with the SHA-256 of its block and
//! that of the chain so far, kept in `integrity.txt`. The recorder writes it; `runs verify` and `recover`
//! tell by it which rows are as they were written, those behind a damaged block included.

use super::samples::{ROW_BYTES, hex};
use sha2::{Digest, Sha256};
use std::str::FromStr;

/// Rows of one link of the hash chain.
pub const LINK_ROWS: usize = 2048;

/// One line of `integrity.txt`: `rows block chain`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Link {
    /// Rows up to the end of the block.
    pub rows: usize,
    /// SHA-256 of the block's bytes, hexadecimal.
    pub block: String,
    /// SHA-256 of the chain before (32 zero bytes at its start) and the block's hash, hexadecimal.
    pub chain: String,
}

impl std::fmt::Display for Link {
    fn fmt(&self, out: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(out, "{} {} {}", self.rows, self.block, self.chain)
    }
}

impl FromStr for Link {
    type Err = ();

    fn from_str(line: &str) -> Result<Self, ()> {
        let mut words = line.split(' ');
        let (rows, block, chain) = (words.next(), words.next(), words.next());
        let hash = |word: Option<&str>| word.filter(|word| word.len() == 64).map(str::to_owned).ok_or(());
        let rows = rows.and_then(|rows| rows.parse().ok()).ok_or(())?;
        Ok(Self { rows, block: hash(block)?, chain: hash(chain)? })
    }
}

/// The chain while rows come in.
#[derive(Clone, Default)]
pub struct RowChain {
    block: Sha256,
    before: [u8; 32],
    rows: usize,
}

impl RowChain {
    /// A chain that goes on behind `rows` rows, a whole number of blocks, whose last link is `before`.
    pub fn after(rows: usize, before: [u8; 32]) -> Self {
        Self { block: Sha256::default(), before, rows }
    }

    /// The chain's hash behind a block, from that before it.
    pub fn chained(before: [u8; 32], block: &[u8; 32]) -> [u8; 32] {
        Sha256::new().chain_update(before).chain_update(block).finalize().into()
    }

    /// Takes rows in; calls `link` with each link that is complete.
    pub fn update(&mut self, mut rows: &[u8], mut link: impl FnMut(Link)) {
        while !rows.is_empty() {
            let missing = (LINK_ROWS - self.rows % LINK_ROWS) * ROW_BYTES;
            let (now, rest) = rows.split_at(missing.min(rows.len()));
            self.block.update(now);
            self.rows += now.len() / ROW_BYTES;
            if self.rows.is_multiple_of(LINK_ROWS) {
                let (complete, chain) = self.link();
                link(complete);
                self.before = chain;
                self.block = Sha256::default();
            }
            rows = rest;
        }
    }

    /// The link that closes the chain here, be its block complete or not; of no rows at all too.
    pub fn last(&self) -> Link {
        if self.rows > 0 && self.rows.is_multiple_of(LINK_ROWS) {
            // The block that is open is empty: the last link was told already, its block hash is not kept.
            return Link { rows: self.rows, block: hex(&Sha256::digest([])), chain: hex(&self.before) };
        }
        self.link().0
    }

    /// Rows taken in.
    pub fn rows(&self) -> usize {
        self.rows
    }

    fn link(&self) -> (Link, [u8; 32]) {
        let block: [u8; 32] = self.block.clone().finalize().into();
        let chain = Self::chained(self.before, &block);
        (Link { rows: self.rows, block: hex(&block), chain: hex(&chain) }, chain)
    }
}
