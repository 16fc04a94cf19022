"""Sections and return maps of motions that repeat themselves, of any system."""
