//! Serves a page, streams as files, and the certificate's digest over HTTP/1.1, for browsers.
//!
//! Files are served in byte ranges (RFC 9110, section 14), so that a page can play one without the session.
//! What a client may cost is bounded: connections, bytes of a request's head, time for it, time without
//! progress of an answer. Nothing is read from the disk: what is served is in memory before the port opens.

mod answer;
mod progress;
mod range;
mod server;
mod site;
#[cfg(test)]
mod tests;
mod upgrade;

pub use server::{HttpConfig, HttpError, HttpLimits, HttpReport, HttpServer};
pub use site::{Assets, Origin, Site, SiteError, SiteStream};
