% One target, seen from a straight track: echoes are made, imaged by pysas_image, and the brightest pixel is where the target is.
fs = 40e3; fc = 60e3; c = 1480; t0 = 10e-3;
ping = 0:47;
survey.fs = fs; survey.fc = fc; survey.c = c; survey.t0 = t0;
survey.tx = [0.05 * ping - 1.2; zeros(2, 48)];                           % 3 x ping
survey.rx = reshape(survey.tx, 3, 1, 48) + [-0.1 0.1; 0 0; 0.1 0.1];     % 3 x channel x ping
target = [0.3; 12; 5];

out = sqrt(sum((survey.tx - target) .^ 2, 1));                           % 1 x ping
back = sqrt(sum((survey.rx - target) .^ 2, 1));                          % 1 x channel x ping
tau = (reshape(out, 1, 1, 48) + back) / c;
t = t0 + (0:399)' / fs - tau;                                            % sample x channel x ping
pulse = ones(size(t));
some = t ~= 0;
pulse(some) = sin(pi * 20e3 * t(some)) ./ (pi * 20e3 * t(some));
data = single(pulse .* exp(-2i * pi * fc * tau));

x = -0.5:0.02:1; y = 11:0.02:13;
image = pysas_image(data, survey, x, y, target(3), 1e-3);
[peak, where] = max(abs(image(:)));
[row, column] = ind2sub(size(image), where);
fprintf('peak %.3f at x = %.2f m, y = %.2f m\n', peak, x(column), y(row));
