// A face between the near plane and the light counts once, whichever way it is seen.
layout(location = 0) out float count;

void main() {
    count = 1.0;
}
