-- The average of a capture by hand: the mean of all shots in volts, less its own first tenth (the baseline).
-- Equal to `profiles.mean_v` where nothing is aligned and nothing rejected: no reference channel, every shot with the same t0_ps, `rejected` 0.
-- Elsewhere the difference is what aligning the shots is worth. Needs 8-bit signed codes in the table `traces` (`codes = "zstd"` under
-- [traces]); of an index average.py reads the raw files.
SET VARIABLE results = 'results';
SET VARIABLE lit = 1;
SET VARIABLE seen = 2;

WITH records AS (
    SELECT *,
        hex(coalesce(codes, error('the samples lie in ' || codes_file || '; `codes = "zstd"` under [traces] archives them'))) AS digits
    FROM read_parquet(getvariable('results') || '/traces/*.parquet')
    WHERE role = 'scene' AND NOT is_reference AND lit = getvariable('lit') AND seen = getvariable('seen') AND code_type = 'i8'
), samples AS (
    SELECT campaign, sensor, CAST(i AS INTEGER) AS sample, gain_v, offset_v, t0_ps + i * dt_ps AS time_ps, samples,
        CAST('0x' || digits[2 * i + 1 : 2 * i + 2] AS INTEGER) AS bits
    FROM (SELECT *, unnest(range(samples)) AS i FROM records)
), mean AS (
    SELECT campaign, sensor, sample, any_value(samples) AS samples, avg(time_ps) AS time_ps, count(*) AS shots,
        avg(gain_v * (bits - CASE WHEN bits >= 128 THEN 256 ELSE 0 END) + offset_v) AS mean_v
    FROM samples GROUP BY ALL
), baseline AS (
    SELECT campaign, sensor, avg(mean_v) AS baseline_v FROM mean WHERE sample < round(samples / 10) GROUP BY ALL
), profile AS (
    SELECT campaign, sensor, unnest(range(len(mean_v))) AS sample, unnest(mean_v) AS profile_v
    FROM read_parquet(getvariable('results') || '/profiles/*.parquet')
    WHERE role = 'scene' AND lit = getvariable('lit') AND seen = getvariable('seen')
)
SELECT campaign, sensor, sample, time_ps, shots, mean_v - baseline_v AS by_hand_v, profile_v
FROM mean JOIN baseline USING (campaign, sensor) LEFT JOIN profile USING (campaign, sensor, sample)
ORDER BY campaign, sensor, sample;
