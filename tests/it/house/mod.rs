//! The rules of ARCHITECTURE.md, kept: who imports whom (`floors`), where packages of others are named (`packages`),
//! how the code looks (`form`), and what comes from others (`supply`). `sources` reads the files that they look at.
//!
//! A rule that some folders do not keep yet lists them in a constant `.._NOT_YET`; a folder that keeps it must leave
//! the list.

mod floors;
mod form;
mod packages;
mod sources;
mod supply;
