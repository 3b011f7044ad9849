"""The application: settings, event loop, recorder, replay, commands."""
