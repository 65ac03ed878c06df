"""Bytes of messages: from arrays into CDR and back, compiled; stamps, signatures, taking without a copy."""
