"""Encoding of messages: arrays to CDR bytes and back by compiled code; stamps, signatures, taking raw messages."""
