"""Prediction: where will the camera be, and which tiles will it see there?"""
