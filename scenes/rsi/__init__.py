"""The ideal robot as a server of KUKA RSI."""
