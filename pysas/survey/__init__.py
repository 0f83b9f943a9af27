"""Surveys: strips of images along a track, from pings as they come."""
