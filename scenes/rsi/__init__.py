"""The ideal robot as a server for KUKA RSI."""
