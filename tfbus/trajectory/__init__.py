"""The poses of one frame over time: as arrays, and in the files of SLAM systems and tables."""
