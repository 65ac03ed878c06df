"""Admission of messages: known publishers, refusals, and nodes that join late or replace another."""
