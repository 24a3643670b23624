//! Makes, reads and checks the certificates by which a server says who it is.
//!
//! There is no way to connect without a check: a client knows the SHA-256 of the certificate (its pin), or
//! the authority that signed it.

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
    sync::{Arc, OnceLock},
    time::{Duration, SystemTime},
};

use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use rustls::{
    CertificateError, DigitallySignedStruct, RootCertStore, SignatureScheme,
    client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature},
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName, UnixTime, pem::PemObject},
};

use super::{message::ALPN, scheme::Scheme, web};

/// How long before now a certificate begins: clocks differ.
const BEFORE: Duration = Duration::from_secs(3600);
/// How long after now it ends. Browsers take no more than 14 days from its begin to its end.
const AFTER: Duration = Duration::from_secs(13 * 86_400);

/// SHA-256 of a certificate in its binary form (DER), written as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Pin([u8; 32]);

impl Pin {
    fn of(certificate: &CertificateDer<'_>) -> Self {
        let digest = ::ring::digest::digest(&::ring::digest::SHA256, certificate);
        let mut pin = [0; 32];
        pin.iter_mut().zip(digest.as_ref()).for_each(|(to, from)| *to = *from);
        Self(pin)
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for Pin {
    type Err = PinError;

    fn from_str(text: &str) -> Result<Self, PinError> {
        let mut pin = [0; 32];
        if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(PinError);
        }
        for (at, byte) in pin.iter_mut().enumerate() {
            let digits = text.get(2 * at..2 * at + 2).ok_or(PinError)?;
            *byte = u8::from_str_radix(digits, 16).map_err(|_| PinError)?;
        }
        Ok(Self(pin))
    }
}

/// A text is no pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("64 hexadecimal digits, the SHA-256 of a certificate, are allowed")]
pub struct PinError;

/// Why there is no identity, or why a certificate cannot be checked.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file cannot be read as PEM.
    #[error("{file}: {what}")]
    File {
        /// Which.
        file: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A certificate cannot be made.
    #[error("cannot make a certificate: {0}")]
    Make(#[from] rcgen::Error),
    /// The certificate and its key do not serve.
    #[error("certificate and key: {0}")]
    Unusable(#[from] rustls::Error),
    /// The cipher suite of first packets is missing.
    #[error("certificate and key: {0}")]
    Suite(#[from] quinn::crypto::rustls::NoInitialCipherSuite),
}

/// A server's certificate and key.
#[derive(Debug)]
pub struct Identity {
    chain: Vec<CertificateDer<'static>>,
    key: PrivateKeyDer<'static>,
}

impl Identity {
    /// A new certificate for `names` (host names or addresses), signed by its own key. Viewers know it by
    /// its pin. It is as browsers want one that they know by its pin: of the curve P-256, valid for less than
    /// 14 days; `dgs play` does not look at its dates.
    ///
    /// # Errors
    /// A name that cannot stand in a certificate.
    pub fn self_signed(names: &[String]) -> Result<Self, IdentityError> {
        let key = rcgen::KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256)?;
        let mut params = rcgen::CertificateParams::new(names)?;
        let now = SystemTime::now();
        params.not_before = (now - BEFORE).into();
        params.not_after = (now + AFTER).into();
        let certificate = params.self_signed(&key)?;
        let key = PrivatePkcs8KeyDer::from(key.serialize_der());
        Ok(Self { chain: vec![certificate.der().clone()], key: key.into() })
    }

    /// The certificate chain and the key in two files of PEM.
    ///
    /// # Errors
    /// A file that cannot be read, or holds neither.
    pub fn read(certificate: &Path, key: &Path) -> Result<Self, IdentityError> {
        let key_of = PrivateKeyDer::from_pem_file(key);
        let chain = certificates(certificate)?;
        Ok(Self { chain, key: key_of.map_err(|error| unreadable(key, &error))? })
    }

    /// By what clients know the certificate.
    pub fn pin(&self) -> Pin {
        self.chain.first().map_or(Pin([0; 32]), Pin::of)
    }

    /// A secret that follows from the key: a server that is started again with the same key has it again.
    pub(super) fn secret(&self, label: &[u8]) -> [u8; 32] {
        let key = ::ring::hmac::Key::new(::ring::hmac::HMAC_SHA256, self.key.secret_der());
        let mut secret = [0; 32];
        secret.copy_from_slice(::ring::hmac::sign(&key, label).as_ref());
        secret
    }

    /// The server's side of the handshake.
    pub(crate) fn server(self) -> Result<QuicServerConfig, IdentityError> {
        let builder = rustls::ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
        let builder = builder.with_protocol_versions(&[&rustls::version::TLS13])?;
        let mut config = builder.with_no_client_auth().with_single_cert(self.chain, self.key)?;
        config.alpn_protocols = vec![ALPN.to_vec(), web::ALPN.to_vec()];
        // No client comes back by a ticket; they would travel before the manifest.
        config.send_tls13_tickets = 0;
        Ok(QuicServerConfig::try_from(config)?)
    }
}

/// By what a client knows the server.
#[derive(Clone, Debug)]
pub enum Trust {
    /// By the SHA-256 of its certificate.
    Pin(Pin),
    /// By a certificate authority in a file of PEM.
    Authority(PathBuf),
}

/// Takes note of the certificate that did not fit the pin.
pub(super) type Mismatch = Arc<OnceLock<Pin>>;

impl Trust {
    /// The client's side of the handshake, and where a wrong certificate is noted.
    pub(crate) fn client(&self, scheme: Scheme) -> Result<(QuicClientConfig, Mismatch), IdentityError> {
        let provider = Arc::new(ring::default_provider());
        let mismatch = Mismatch::default();
        let builder = rustls::ClientConfig::builder_with_provider(provider.clone());
        let builder = builder.with_protocol_versions(&[&rustls::version::TLS13])?;
        let mut config = match self {
            Self::Pin(pin) => {
                let pinned = Pinned { pin: *pin, provider, mismatch: mismatch.clone() };
                builder.dangerous().with_custom_certificate_verifier(Arc::new(pinned)).with_no_client_auth()
            }
            Self::Authority(file) => {
                let mut roots = RootCertStore::empty();
                for certificate in certificates(file)? {
                    roots.add(certificate).map_err(|error| unreadable(file, &error))?;
                }
                builder.with_root_certificates(roots).with_no_client_auth()
            }
        };
        let protocol = match scheme {
            Scheme::Dgs => ALPN,
            Scheme::Https | Scheme::Moq => web::ALPN,
        };
        config.alpn_protocols = vec![protocol.to_vec()];
        Ok((QuicClientConfig::try_from(config)?, mismatch))
    }
}

fn unreadable(file: &Path, what: &dyn fmt::Display) -> IdentityError {
    IdentityError::File { file: file.to_owned(), what: what.to_string() }
}

/// The certificates in a file of PEM, at least one.
fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, IdentityError> {
    let read = CertificateDer::pem_file_iter(file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let chain = read.map_err(|error| unreadable(file, &error))?;
    if chain.is_empty() {
        return Err(unreadable(file, &"holds no certificate"));
    }
    Ok(chain)
}

/// Accepts one certificate, whatever its names and dates say.
#[derive(Debug)]
struct Pinned {
    pin: Pin,
    provider: Arc<CryptoProvider>,
    mismatch: Mismatch,
}

impl ServerCertVerifier for Pinned {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _chain: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let found = Pin::of(certificate);
        if found == self.pin {
            return Ok(ServerCertVerified::assertion());
        }
        let _ = self.mismatch.set(found);
        Err(CertificateError::ApplicationVerificationFailure.into())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls12_signature(message, certificate, signature, algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls13_signature(message, certificate, signature, algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pin_is_the_certificate_and_is_read_back() {
        let names = ["localhost".to_owned()];
        let (one, other) = (Identity::self_signed(&names).unwrap(), Identity::self_signed(&names).unwrap());
        assert_ne!(one.pin(), other.pin());
        assert_eq!(one.pin().to_string().parse::<Pin>(), Ok(one.pin()));
        assert_eq!("xyz".parse::<Pin>(), Err(PinError));
        assert_eq!("é".repeat(32).parse::<Pin>(), Err(PinError));
    }

    #[test]
    fn files_that_hold_no_certificate_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let empty = folder.path().join("empty.pem");
        std::fs::write(&empty, "nothing").unwrap();
        let error = Trust::Authority(empty.clone()).client(Scheme::Dgs).err().unwrap();
        assert!(error.to_string().contains("empty.pem: holds no certificate"), "{error}");
        let missing = folder.path().join("missing.pem");
        assert!(Identity::read(&empty, &missing).unwrap_err().to_string().contains("pem: "));
    }
}
