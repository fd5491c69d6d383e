"""The authority of a closed fleet: certificates for its principals, and who may do what."""
