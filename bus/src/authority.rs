//! Certificates of a bench: one certificate authority, and one key for each node that it signs.

use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa, KeyPair,
    KeyUsagePurpose,
};

use crate::protection::Identity;

/// Error when a key or certificate cannot be created.
#[derive(Debug, thiserror::Error)]
#[error("no certificate can be made for {who}: {source}")]
pub struct AuthorityError {
    /// Name of the node, or of the authority itself.
    pub who: String,
    /// Underlying error.
    pub source: rcgen::Error,
}

/// Certificate authority of one bench. Its key is never stored: after it is dropped, no further node can
/// join.
pub struct Authority {
    issuer: CertifiedIssuer<'static, KeyPair>,
}

impl Authority {
    /// A new authority with a fresh key (ECDSA on P-256).
    ///
    /// # Errors
    /// When the operating system has no random numbers.
    pub fn new(bench: &str) -> Result<Self, AuthorityError> {
        let failed = |source| AuthorityError { who: format!("the authority of {bench}"), source };
        let mut params = named(Vec::new(), &format!("whirlstand {bench}")).map_err(failed)?;
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let issuer =
            KeyPair::generate().and_then(|key| CertifiedIssuer::self_signed(params, key)).map_err(failed)?;
        Ok(Self { issuer })
    }

    /// Certificate of the authority, PEM, which every node needs.
    pub fn certificate(&self) -> String {
        self.issuer.pem()
    }

    /// A fresh key and a certificate for the node `name`, valid on `hosts` (DNS names or IP addresses).
    ///
    /// # Errors
    /// For an invalid host, and when the operating system has no random numbers.
    pub fn issue(&self, name: &str, hosts: &[String]) -> Result<Identity, AuthorityError> {
        let failed = |source| AuthorityError { who: name.into(), source };
        let mut params = named(hosts.to_vec(), name).map_err(failed)?;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        // Every node is both server and client.
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        let key = KeyPair::generate().map_err(failed)?;
        let certificate = params.signed_by(&key, &self.issuer).map_err(failed)?;
        Ok(Identity {
            authority: self.certificate(),
            certificate: certificate.pem(),
            key: key.serialize_pem(),
        })
    }
}

fn named(hosts: Vec<String>, common_name: &str) -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(hosts)?;
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, common_name);
    Ok(params)
}
